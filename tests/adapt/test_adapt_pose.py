"""Fits of poses: more steps are never worse than fewer, and hands on neighbouring fingers are corrected."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from adapt_scene import make_scene, task_of

import jaxcap as jc
from jaxcap.adapt.objective import PoseTerms
from jaxcap.adapt.poses.finger_slips import correct_finger_slips, find_hands
from jaxcap.adapt.poses.fit_frame import fit_pose
from jaxcap.adapt.prepare import make_adapt_task
from jaxcap.adapt.task import AdaptState
from jaxcap.body.body import posed_vertices
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.retraction import retract
from jaxcap.fit.correspondence.nearest_assignment import make_scan
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import sample_surface


@pytest.fixture(scope="module")
def scene():
    return make_scene()


def start_of(scene, size: float):
    """The actor, a scan, and a pose that is off by so many radians and a tenth as many metres."""
    _, actor, poses, _ = scene
    task, way = task_of(scene), np.random.default_rng(1).normal(size=actor.skeleton.num_dofs)
    way[:3] *= 0.1
    return (
        actor,
        task.prior,
        make_scan(task.cloud(2)),
        retract(actor.skeleton, poses[2], jnp.asarray(size * way)),
    )


def test_more_steps_are_never_worse_than_fewer(scene):
    actor, prior, scan, start = start_of(scene, 0.15)
    values = [
        fit_pose(actor, scan, start, PoseTerms(prior, 1e-8), steps=steps).data for steps in (1, 2, 4, 8, 12)
    ]
    assert (np.diff(values) <= 1e-15).all()
    assert values[-1] < 0.5 * values[0]


def test_fingers_that_lie_on_their_neighbours_are_corrected(rng):
    body = jc.human(joints="tracking", resolution="medium")
    skeleton, motion = body.skeleton, walk_and_wave(body.skeleton, 1.0).slice(slice(0, None, 10))
    surfaces = [np.asarray(posed_vertices(body, motion[n]), float) for n in range(len(motion))]
    clouds = []
    for surface in surfaces:
        points, normals = sample_surface(surface, np.asarray(body.faces), 20_000, rng)
        clouds.append(jc.make_cloud(points + 0.001 * rng.normal(size=points.shape), normals))
    hand = skeleton.index("RightHand")
    (palm,) = (found for found in find_hands(body) if found.joint == hand)
    wrong = (
        motion[1]
        .rotations.at[hand]
        .set(rotation.multiply(motion[1].rotations[hand], rotation.exp(jnp.asarray(0.27 * palm.normal))))
    )
    task = make_adapt_task(body, clouds, 3.0, planes=())
    poses = {n: motion[n] for n in range(len(motion))}
    poses[1] = eqx.tree_at(lambda pose: pose.rotations, motion[1], wrong)
    fingers = body.skeleton.descendants[hand][np.asarray(body.skin.dominant_bones())]

    def error(pose):
        return np.linalg.norm(np.asarray(posed_vertices(body, pose)) - surfaces[1], axis=1)[fingers].mean()

    assert error(poses[1]) > 0.008

    def correct(poses):
        motion = jc.stack_poses(list(poses.values()), 3.0)
        return correct_finger_slips(task, AdaptState(0, body, 1.0, motion, pose_weight=1e-8))

    changed = correct(poses)
    assert list(changed) == [1]
    assert error(changed[1]) < 0.002
    assert correct(poses | changed) == {}
