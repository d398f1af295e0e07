"""The shape of a person from tracked frames, against a person of a known build."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.adapt.shape.shape_space import learn_shape_space
from jaxcap.adapt.shape.tracked_shape import fit_shape, fit_tracked_shape
from jaxcap.body.people.performance import walk_and_wave
from jaxcap.body.people.random_humans import sample_humans
from jaxcap.geometry.mesh import sample_surface
from tests.helpers import chain_body

BUILD = dict(sex="female", weight=0.3, height=1.6)


@pytest.fixture(scope="module")
def scene():
    """A small woman in three poses as clouds, and a tracker of the generic human with her rotations."""
    template = jc.human(resolution="low", joints="tracking")
    person = jc.human(resolution="low", joints="tracking", **BUILD)
    rng, clouds, poses = np.random.default_rng(3), [], []
    performed, started = (walk_and_wave(body.skeleton, 1.5) for body in (person, template))
    for number in range(3):
        posed = jc.pose_body(person, performed[20 * number])
        points, normals = sample_surface(
            np.asarray(posed.vertices, float), np.asarray(person.faces), 1000, rng
        )
        clouds.append(jc.make_cloud(points + 0.003 * rng.normal(size=points.shape), normals))
        poses.append(started[20 * number])
    space = learn_shape_space(template, sample_humans(80, resolution="low", joints="tracking"))
    return person, jc.make_tracker(template), clouds, poses, space


def joint_error(body: jc.Body, other: jc.Body) -> float:
    """Mean distance of joints, metres, about their means."""
    centres = [b.skeleton.centres - b.skeleton.centres.mean(0) for b in (body, other)]
    return float(jnp.linalg.norm(centres[0] - centres[1], axis=1).mean())


def test_a_small_woman_is_found_from_the_generic_human(scene):
    person, tracker, clouds, poses, space = scene
    assert joint_error(tracker.body, person) > 0.04
    found = fit_tracked_shape(tracker, clouds, poses, space)
    assert joint_error(found, person) < 0.01
    heights = [float(jnp.ptp(body.vertices[:, 1])) for body in (found, person)]
    assert heights[0] == pytest.approx(heights[1], abs=0.01)


def test_what_has_no_shape_space_is_told(scene):
    _, _, clouds, poses, _ = scene
    with pytest.raises(jc.InputError, match="not like a human, so its shape space is unknown"):
        fit_shape(jc.make_tracker(chain_body()), clouds)
    with pytest.raises(jc.InputError, match="3 clouds and 2 poses; expected one pose for each cloud"):
        fit_tracked_shape(scene[1], clouds, poses[:2], scene[4])
    with pytest.raises(jc.InputError, match="num_frames"):
        fit_shape(scene[1], clouds, scene[4], num_frames=0)
