"""A limb in motion, as small clouds, and a run of tasks in this process."""

from collections.abc import Callable, Sequence
from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from benchmarks.tracking._long_scene import make_limb
from jaxcap.body.body import Body, pose_body
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import make_skeleton
from jaxcap.geometry.mesh import sample_surface
from jaxcap.observe.clouds import Cloud, make_cloud
from jaxcap.tracking.chunks.join_chunks import Outcome
from jaxcap.tracking.chunks.tasks import Task, TrackSettings
from jaxcap.tracking.chunks.track_chunks import _track
from jaxcap.tracking.track_frame import make_tracker


def make_hinged_limb() -> Body:
    """Make a limb whose joints bend about known axes, so that few points determine its pose."""
    limb = make_limb()
    axes = np.tile([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], (3, 1, 1))
    kinds = ("free", "revolute", "revolute")
    skeleton = make_skeleton(
        limb.skeleton.names, limb.skeleton.parents, kinds, limb.skeleton.centres, axes=axes
    )
    return Body(skeleton, limb.skin, limb.vertices, limb.faces)


BODY = make_hinged_limb()
SKELETON = BODY.skeleton
TRACKER = make_tracker(BODY)
POINTS, NOISE = 300, 0.002
_pose_body = eqx.filter_jit(pose_body)


def pose_of(frame: float) -> Pose:
    """The limb sways, and both joints bend."""
    d, phase = np.zeros(SKELETON.num_dofs), 2 * np.pi * frame / 200
    d[:3] = 0.05 * np.sin(phase), 0.0, 0.03 * np.sin(2 * phase)
    d[6:] = 0.4 * np.sin(phase + np.arange(2))
    return retract(SKELETON, rest_pose(SKELETON), jnp.asarray(d))


def scan(pose: Pose, seed: int) -> Cloud:
    rng = np.random.default_rng(seed)
    vertices = np.asarray(_pose_body(BODY, pose).vertices)
    points, normals = sample_surface(vertices, np.asarray(BODY.faces), POINTS, rng)
    return make_cloud(points + NOISE * rng.normal(size=points.shape), normals)


def scan_frames(count: int) -> list[Cloud]:
    return [scan(pose_of(frame), frame) for frame in range(count)]


def joints(pose: Pose) -> np.ndarray:
    return np.asarray(_pose_body(BODY, pose).joints)


def run_here(
    clouds: Sequence[Cloud], settings: TrackSettings, begun: list[Task]
) -> Callable[[Sequence[Task]], list[tuple[int, Outcome]]]:
    """Run tasks in this process, and note them in `begun`."""
    track = partial(_track, TRACKER, settings)

    def run(tasks):
        begun.extend(tasks)
        return [(k, track((task, clouds[task.first : task.end]))) for k, task in enumerate(tasks)]

    return run
