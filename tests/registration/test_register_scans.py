"""Scans registered to the vertices of a body: known surfaces, partial scans, and frames that fail."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body

import jaxcap as jc
from jaxcap.adapt.registration.collect import collect_registered
from jaxcap.adapt.registration.register_scans import RegisteredScan, RegisterSettings, register_scans
from jaxcap.adapt.task import AdaptState, AdaptTask
from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.retraction import retract
from jaxcap.errors import InputError
from jaxcap.geometry.mesh import sample_surface
from jaxcap.metrics import scan_to_surface

FRAMES, POINTS, NOISE = 5, 3000, 0.001
BODY = chain_body("linear", 10, 8)
SETTINGS = RegisterSettings(num_points=POINTS)
_posed = eqx.filter_jit(jc.pose_body)


def wider(body: jc.Body) -> jc.Body:
    """A person whose surface is 6 mm wider on one side than the body's, and smooth."""
    normals = np.asarray(_posed(body, rest_pose(body.skeleton)).normals)
    side = 0.5 + 0.5 * np.tanh(np.asarray(body.vertices)[:, :1] / 0.05)
    return eqx.tree_at(lambda b: b.vertices, body, body.vertices + jnp.asarray(0.006 * side * normals))


@pytest.fixture(scope="module")
def scene():
    """The poses, the true vertices and the clouds of all frames."""
    rng, person = np.random.default_rng(5), wider(BODY)
    way = 0.03 * rng.normal(size=BODY.skeleton.num_dofs)
    poses = [retract(BODY.skeleton, rest_pose(BODY.skeleton), jnp.asarray(n * way)) for n in range(FRAMES)]
    truth = np.stack([np.asarray(_posed(person, pose).vertices, float) for pose in poses])
    clouds = []
    for vertices in truth:
        points, normals = sample_surface(vertices, np.asarray(BODY.faces), POINTS, rng)
        clouds.append(jc.make_cloud(points + NOISE * rng.normal(size=points.shape), normals))
    return poses, truth, clouds


def task_of(cloud, poses, **changes) -> tuple[AdaptTask, AdaptState]:
    task = jc.make_adapt_task(
        BODY, [cloud(0)] * FRAMES, 10.0, settings=jc.adapt.AdaptSettings(unordered=False)
    )
    state = AdaptState(99, BODY, 1.0, stack_poses(poses, 10.0))
    return task._replace(cloud=cloud, **changes), state


def test_vertices_are_those_of_the_person(scene):
    poses, truth, clouds = scene
    task, state = task_of(clouds.__getitem__, poses)
    found = list(register_scans(task, state, SETTINGS))
    guides = np.stack([np.asarray(_posed(BODY, pose).vertices, float) for pose in poses])
    registered = collect_registered(BODY, found, 10.0)
    meshes, faces = np.asarray(registered.meshes.vertices, float), np.asarray(BODY.faces)
    away, before = (
        np.concatenate([scan_to_surface(*each, faces) for each in zip(truth, surfaces, strict=True)])
        for surfaces in (meshes, guides)
    )
    assert np.median(away) < 0.0007 < 0.3 * np.median(before)
    # points show the distance across the surface only: along it vertices follow their neighbours
    errors, offsets = (np.median(np.linalg.norm(each - truth, axis=2)) for each in (meshes, guides))
    assert errors < 0.9 * offsets
    assert registered.frames == tuple(range(FRAMES)) and not registered.failures
    assert registered.seen.mean() > 0.95
    # points of a normal distribution: the median distance is two thirds of the deviation
    assert registered.median_distances == pytest.approx(0.6745 * NOISE, rel=0.3)
    assert np.nanmedian(registered.distances) < 2 * NOISE
    assert registered.meshes.rate == 10.0 and not any(scan.poor_parts for scan in found)


def test_a_frame_that_fails_does_not_end_the_others(scene):
    poses, _, clouds = scene

    def cloud(frame: int) -> jc.Cloud:
        if frame == 1:
            raise InputError("scan_0001.ply is empty; expected at least one point.")
        if frame == 2:
            return jc.make_cloud(
                np.asarray(clouds[2].points) + [3.0, 0.0, 0.0], np.asarray(clouds[2].normals)
            )
        return clouds[frame]

    task, state = task_of(cloud, poses, missing=(3,))
    found = list(register_scans(task, state, SETTINGS))
    registered = collect_registered(BODY, found)
    assert registered.frames == (0, 4)
    assert registered.failures[1] == "scan_0001.ply is empty; expected at least one point."
    assert registered.failures[2] == "inf mm from scan to surface, which explains 0% of the points near it"
    assert registered.failures[3] == "no usable scan"
    np.testing.assert_array_equal(found[3].vertices, np.asarray(_posed(BODY, poses[3]).vertices, float))
    lost = state._replace(lost=(0, 4), reasons=("12.0 mm from scan to body", "bent"))
    with pytest.raises(InputError, match=r"None of 5 scans .* frame 0: 12\.0 mm from scan to body; give"):
        collect_registered(BODY, register_scans(task, lost, SETTINGS))


def test_a_frame_far_above_the_others_is_left_out():
    def scan(frame: int, distance: float) -> RegisteredScan:
        count = len(BODY.vertices)
        return RegisteredScan(frame, np.zeros((count, 3)), np.ones(count, bool), np.zeros(count), distance)

    registered = collect_registered(BODY, [scan(n, 0.012 if n == 2 else 0.001) for n in range(5)])
    assert registered.frames == (0, 1, 3, 4)
    assert registered.failures == {2: "12.0 mm from scan to surface, compared with 1.0 mm over all frames"}


def test_parts_far_from_the_scan_are_named(scene):
    poses, _, clouds = scene
    task, state = task_of(clouds.__getitem__, poses)
    shift = jnp.zeros(BODY.skeleton.num_dofs).at[:3].set(jnp.array([0.0, 0.0, 0.035]))
    moved = [retract(BODY.skeleton, pose, shift) for pose in poses]
    (scan,) = register_scans(task, state._replace(motion=stack_poses(moved, 10.0)), SETTINGS, [0])
    assert scan.poor_parts and all(0.02 < size < 0.04 for _, size in scan.poor_parts)
    assert {name for name, _ in scan.poor_parts} <= set(BODY.skeleton.names)


@pytest.mark.parametrize("changes", [{"deviation": 0.0}, {"length": -1.0}, {"num_points": 0}])
def test_settings_out_of_range(scene, changes):
    poses, _, clouds = scene
    task, state = task_of(clouds.__getitem__, poses)
    with pytest.raises(InputError, match=f"RegisterSettings: `{next(iter(changes))}`"):
        register_scans(task, state, SETTINGS._replace(**changes))
