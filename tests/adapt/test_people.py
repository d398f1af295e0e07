"""Shape coefficients of people, from bodies and from scans."""

import dataclasses
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body

import jaxcap as jc
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.compare_people import compare_people, group_people
from jaxcap.adapt.shape import people_shapes, tracked_shape
from jaxcap.adapt.shape.people_shapes import estimate_people_shapes
from jaxcap.adapt.shape.shape_space import fit_coefficients, learn_shape_space, shape_space_like
from jaxcap.adapt.shape.tracked_shape import estimate_shape, fit_tracked_shape
from jaxcap.adapt.task import AdaptSettings, AdaptState, AdaptTask
from jaxcap.body.body import body_height
from jaxcap.body.body_model import shape_from_template
from jaxcap.body.decimate import reduce_body
from jaxcap.body.people.random_humans import human_resolution, sample_humans
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.geometry.attachment import attach_points, attached_positions
from jaxcap.geometry.mesh import sample_surface
from jaxcap.metrics import scan_to_surface


@pytest.fixture(scope="module")
def people():
    template = jc.human(resolution="low", joints="tracking")
    return learn_shape_space(template, sample_humans(80, resolution="low", joints="tracking"))


def seen_with(somebody: jc.Body, seen: jc.Body) -> jc.Body:
    """The surface that is seen, with the joints of who it is."""
    return eqx.tree_at(lambda b: b.vertices, somebody, seen.vertices)


def joints_off(body: jc.Body, other: jc.Body) -> float:
    """Mean distance of joints, metres, with both surfaces about their middles."""
    places = [b.skeleton.centres - b.vertices.mean(0) for b in (body, other)]
    return float(jnp.linalg.norm(places[0] - places[1], axis=1).mean())


def test_the_template_stands_where_it_was_put(people):
    """Coefficients of zero are the template, and the negative of its own the mean of people."""
    np.testing.assert_array_equal(
        shape_from_template(people, jnp.zeros_like(people.template_coefficients)).vertices,
        people.template.vertices,
    )
    others = sample_humans(80, resolution="low", joints="tracking")
    mean = np.mean([np.asarray(body.vertices) for body in others], 0)
    np.testing.assert_allclose(
        shape_from_template(people, -people.template_coefficients).vertices, mean, atol=0.004
    )


def test_modes_are_of_deviation_one(people):
    others = sample_humans(80, resolution="low", joints="tracking")
    basis = np.concatenate([np.asarray(part).reshape(len(people.template_coefficients), -1) for part in (people.modes.centres, people.modes.vertices)], 1)  # fmt: skip
    rows = np.stack([np.concatenate([np.asarray(b.skeleton.centres).ravel(), np.asarray(b.vertices).ravel()]) for b in others])  # fmt: skip
    coefficients = np.linalg.lstsq(basis.T, (rows - rows.mean(0)).T, rcond=None)[0]
    np.testing.assert_allclose(np.cov(coefficients), np.eye(len(coefficients)), atol=0.02)


@pytest.mark.parametrize("shift", [0.0, 0.5])
def test_somebody_new_is_known_by_the_surface(people, shift):
    """One who was not among those learned from, wherever the body stands."""
    somebody = jc.human(resolution="low", joints="tracking", sex="female", height=1.58, weight=0.8, age=40)
    found = shape_from_template(people, fit_coefficients(people, eqx.tree_at(lambda b: b.vertices, somebody, somebody.vertices + shift)))  # fmt: skip
    assert joints_off(found, somebody) < 0.003
    assert joints_off(people.template, somebody) > 0.02


def test_people_of_fewer_vertices_are_those_of_all(people):
    """A template that was reduced: somebody new is on its surface, and has the same joints."""
    template = reduce_body(people.template, 900)
    fewer = shape_space_like(template, people.template)
    assert fewer is not None
    somebody = jc.human(resolution="low", joints="tracking", sex="female", height=1.58, weight=0.8, age=40)
    surface = np.asarray(people.template.vertices, float), np.asarray(people.template.faces)
    hold = attach_points(np.asarray(template.vertices, float), *surface)
    there = attached_positions(hold, np.asarray(somebody.vertices, float))
    seen = eqx.tree_at(lambda b: b.vertices, template, jnp.asarray(there, jnp.float32))
    found = shape_from_template(fewer, fit_coefficients(fewer, seen))
    off = scan_to_surface(
        np.asarray(found.vertices, float), np.asarray(somebody.vertices, float), np.asarray(somebody.faces)
    )
    assert np.median(off) < 0.003
    assert float(jnp.linalg.norm(found.skeleton.centres - somebody.skeleton.centres, axis=1).mean()) < 0.004


@pytest.mark.parametrize("traits", [{}, {"sex": "female", "weight": 0.9, "height": 1.55}])
def test_people_of_other_triangles_are_those_of_somebody_like_them(traits):
    """Of a template that is nobody's reduced by name, and stands elsewhere: somebody new is on its surface, joints and all."""
    whole, shift = jc.human(resolution="full", joints="tracking", **traits), jnp.array([0.3, -0.8, 0.1])
    template = reduce_body(whole, 2000)
    template = eqx.tree_at(lambda b: (b.vertices, b.skeleton.centres), template, (template.vertices + shift, template.skeleton.centres + shift))  # fmt: skip
    people = shape_space_like(template)
    assert people is not None
    somebody = jc.human(resolution="full", joints="tracking", sex="male", height=1.85, weight=0.6)
    hold = attach_points(np.asarray(template.vertices - shift, float), np.asarray(whole.vertices, float), np.asarray(whole.faces))  # fmt: skip
    there = attached_positions(hold, np.asarray(somebody.vertices, float))
    seen = eqx.tree_at(lambda b: b.vertices, template, jnp.asarray(there, jnp.float32))
    found = shape_from_template(people, fit_coefficients(people, seen))
    assert joints_off(found, seen_with(somebody, seen)) < 0.3 * joints_off(
        template, seen_with(somebody, seen)
    )
    off = scan_to_surface(
        np.asarray(found.vertices - found.vertices.mean(0), float),
        np.asarray(somebody.vertices - seen.vertices.mean(0), float),
        np.asarray(somebody.faces),
    )
    assert np.median(off) < 0.005


def test_nobody_is_like_something_else(people):
    """Other joints, another rest pose, another being."""
    template = reduce_body(people.template, 900)
    assert shape_space_like(eqx.tree_at(lambda b: b.vertices, template, 1.5 * template.vertices)) is None
    names = tuple(f"bone {n}" for n in range(template.skeleton.num_joints))
    other = dataclasses.replace(template.skeleton, names=names)
    assert shape_space_like(eqx.tree_at(lambda b: b.skeleton, template, other)) is None


def test_scans_determine_the_shape_coefficients(people):
    """With nothing but clouds: a woman from the template of a man, her joints as far within as his are not."""
    actor = jc.human(resolution="low", joints="tracking", sex="female", height=1.6, weight=0.7)
    motion, posed = walk_and_wave(actor.skeleton, seconds=0.4), eqx.filter_jit(jc.pose_body)

    def cloud(frame):
        rng = np.random.default_rng(frame)
        vertices = np.asarray(posed(actor, motion[frame]).vertices, float)
        points, normals = sample_surface(vertices, np.asarray(actor.faces), 1000, rng)
        return jc.make_cloud(points + 0.002 * rng.normal(size=points.shape), normals)

    prior = RestPrior(jnp.full((actor.skeleton.num_joints, 3), 0.7))
    settings = AdaptSettings(num_frames=3, proportion_rounds=4, rounds=(), temporal_weight=0.0)
    task = AdaptTask(people.template, cloud, 4, 30.0, motion[0], prior, (), settings, people)
    *_, last = adapt_body(task)
    assert joints_off(last.body, actor) < 0.012
    assert joints_off(jc.human(resolution="low", joints="tracking", height=1.6), actor) > 0.015


def test_only_the_human_s_triangles_are_the_human_s():
    assert human_resolution(jc.human(resolution="low")) == "low"
    assert human_resolution(jc.human(resolution=900)) is None


def test_bodies_of_other_triangles_are_refused(people):
    with pytest.raises(ValueError, match="Body 1 has 900 vertices"):
        learn_shape_space(people.template, [people.template, jc.human(resolution=900, joints="tracking")])
    with pytest.raises(ValueError, match="at least two"):
        learn_shape_space(people.template, [people.template])


BUILD = dict(sex="female", weight=0.3, height=1.6)


@pytest.fixture(scope="module")
def tracked(people):
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
    return person, jc.make_tracker(template), clouds, poses, people


def test_a_small_woman_is_found_from_the_generic_human(tracked):
    person, tracker, clouds, poses, space = tracked
    assert joints_off(tracker.body, person) > 0.04
    found = fit_tracked_shape(tracker, clouds, poses, space)
    assert joints_off(found, person) < 0.01
    heights = [float(jnp.ptp(body.vertices[:, 1])) for body in (found, person)]
    assert heights[0] == pytest.approx(heights[1], abs=0.01)


def test_the_first_steps_to_a_child_are_no_extrapolation(tracked):
    """Surface beyond the ends of the clouds counts as the points do, so that no coefficient goes far beyond people's."""
    _, tracker, clouds, poses, space = tracked
    small = [eqx.tree_at(lambda c: c.points, cloud, 0.75 * cloud.points) for cloud in clouds]
    body = fit_tracked_shape(tracker, small, poses, space, 1, 0)
    assert float(jnp.abs(fit_coefficients(space, body)).max()) < 6


def test_two_people_in_the_same_clouds_have_their_own_shapes(tracked):
    """A small woman next to the man of the template, both from the generic body."""
    person, tracker, clouds, _, space = tracked
    rng, both = np.random.default_rng(4), []
    performed = walk_and_wave(tracker.body.skeleton, 1.5)
    for number, cloud in enumerate(clouds):
        posed = jc.pose_body(tracker.body, performed[20 * number])
        man, normals = sample_surface(
            np.asarray(posed.vertices, float), np.asarray(posed.body.faces), 1000, rng
        )
        count = int((np.asarray(cloud.weights) > 0).sum())
        both.append(
            jc.make_cloud(
                np.concatenate([np.asarray(cloud.points)[:count], man + [1.5, 0, 0]]),
                np.concatenate([np.asarray(cloud.normals)[:count], normals]),
            )
        )
    found = estimate_people_shapes(tracker, both, 2, space, search=False)
    assert len(found) == 2
    small, large = sorted(found, key=lambda body: float(jnp.ptp(body.vertices[:, 1])))
    assert joints_off(small, person) < 0.012
    assert joints_off(large, tracker.body) < 0.012


def test_a_person_who_is_always_near_another_one_has_a_shape(tracked, monkeypatch):
    person, tracker, clouds, poses, space = tracked

    own = people_shapes._OwnFrames({}, {}, {}, dict(enumerate(clouds)))
    for number, verdict in enumerate(("good", "good", "doubtful")):
        own.add(number, poses[number], verdict, True)
    assert (list(own.separate), list(own.good), list(own.others)) == ([], [0, 1], [2])
    own.touching[2] = own.others.pop(2)
    monkeypatch.setattr(people_shapes, "_track", lambda *_: [own])
    (found,) = estimate_people_shapes(tracker, clouds, 1, space)
    assert joints_off(found, person) < 0.01


def follow_with(monkeypatch, poses, verdict: str, size: float) -> list[jc.Body]:
    """Give all frames a verdict and the first one a size; return the list of the bodies that are tracked."""
    bodies = []

    def tracked_frames(tracker, clouds, search):
        bodies.append(tracker.body)
        return [SimpleNamespace(verdict=verdict, pose=pose) for pose in poses]

    monkeypatch.setattr(tracked_shape, "track_frames", tracked_frames)
    monkeypatch.setattr(tracked_shape, "search_size", lambda *_: size)
    return bodies


def test_frames_that_are_all_lost_are_refused(tracked, monkeypatch):
    """They are tracked once more, with a first shape."""
    _, tracker, clouds, poses, space = tracked
    bodies = follow_with(monkeypatch, poses, "lost", 1.0)
    with pytest.raises(jc.InputError, match="all of 3 frames have the verdict 'lost'"):
        estimate_shape(tracker, clouds, space)
    assert bodies[0] is tracker.body
    assert len(bodies) == 2
    assert float(jnp.abs(bodies[1].vertices - tracker.body.vertices).max()) > 0.01


def test_doubtful_frames_show_a_person_of_another_size(tracked, monkeypatch):
    """People in clothes have no good frames; the size that was searched for is the start."""
    person, tracker, clouds, poses, space = tracked
    bodies = follow_with(monkeypatch, poses, "doubtful", 0.9)
    found = estimate_shape(tracker, clouds, space)
    assert joints_off(found, person) < 0.01
    heights = [float(body_height(body)) for body in bodies]
    assert len(bodies) == 3
    assert heights[1] / heights[0] == pytest.approx(0.9, abs=0.02)


def test_what_has_no_shape_space_is_told(tracked):
    _, _, clouds, poses, _ = tracked
    with pytest.raises(jc.InputError, match="not like a human, so its shape space is unknown"):
        estimate_shape(jc.make_tracker(chain_body()), clouds)
    with pytest.raises(jc.InputError, match="3 clouds and 2 poses; expected one pose for each cloud"):
        fit_tracked_shape(tracked[1], clouds, poses[:2], tracked[4])
    with pytest.raises(jc.InputError, match="num_frames"):
        estimate_shape(tracked[1], clouds, tracked[4], num_frames=0)


@pytest.mark.parametrize("weight", [0.5, 0.75])
def test_scans_of_two_people_of_one_size_are_noticed(people, weight):
    """The adapted body is between both people, in the true poses."""
    bodies = [jc.human(resolution="low", joints="tracking", weight=w) for w in (0.5, weight)]
    numbers = [0, 0, 1, 0, 1]
    between = shape_from_template(people, sum(fit_coefficients(people, body) for body in bodies) / 2)
    motion = walk_and_wave(between.skeleton)
    rng, poses, clouds = np.random.default_rng(0), [], []
    for frame, number in enumerate(numbers):
        pose, body = motion[12 * frame], bodies[number]
        points, normals = sample_surface(
            np.asarray(jc.pose_body(body, pose).vertices, float), np.asarray(body.faces), 3000, rng
        )
        clouds.append(jc.make_cloud(points + 0.002 * rng.normal(size=points.shape), normals))
        poses.append(pose)
    prior = RestPrior(jnp.full((between.skeleton.num_joints, 3), 0.7))
    task = AdaptTask(
        between, clouds.__getitem__, 5, 30.0, None, prior, (), AdaptSettings(), shape_space=people
    )
    state = AdaptState(1, between, 1.0, jc.stack_poses(poses, 30.0), pose_weight=1e-6)
    others = compare_people(task, state)
    if weight == 0.5:
        assert others == ()
        return
    assert [other.frames for other in others] == [(2, 4)]
    (name, shift), *_ = others[0].differences
    assert name in ("chest", "pelvis", "thighs") and 0.001 < shift < 0.01
    # a lost scan is not compared, and nothing is without a shape space
    assert compare_people(task, state._replace(lost=(2, 4))) == ()
    assert compare_people(task._replace(shape_space=None), state) == ()


def test_groups_of_people_by_their_distances():
    def groups(*values: float, poses: tuple[float, ...] = ()) -> list[list[int]]:
        angles = np.array(poses or np.arange(len(values)) % 2, float)
        return group_people(np.array(values)[:, None] * [1.0, -0.5], np.abs(angles[:, None] - angles))

    assert groups(0.0, 0.4, 0.8) == [[0, 1, 2]]
    assert groups(0.0, 1.4, 0.3) == [[0, 2], [1]]
    # three people, who differ little, but their own scans differ less
    values = (0.0, 0.5, 0.02, 0.52, 0.04, 0.98, 0.03, 0.01)
    assert groups(*values) == [[0, 2, 4, 6, 7], [1, 3], [5]]
    assert groups(0.0, 0.1, 0.2, 0.3, 0.6) == [[0, 1, 2, 3, 4]]
    # one person in other poses, and another one
    values = (0.0, 0.5, 0.02, 0.52, 0.04, 2.5)
    assert groups(*values, poses=(0.0, 1.0, 0.1, 1.1, 0.2, 0.1)) == [[0, 1, 2, 3, 4], [5]]
