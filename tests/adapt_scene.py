"""A small actor, the template it is adapted from, and its scans."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from helpers import chain_body

import jaxcap as jc
from jaxcap.adapt.task import AdaptSettings, AdaptTask
from jaxcap.body.body import scale_body
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import retract
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.geometry.camera import ring_of_cameras
from jaxcap.geometry.mesh import sample_surface
from jaxcap.io.cameras import write_cameras
from jaxcap.io.meshes.ply import write_ply

FRAMES, POINTS = 6, 700
RING = ring_of_cameras(4, 360, 2.5, 0.5, (0.0, 0.3, 0.0))
_posed = eqx.filter_jit(jc.pose_body)


def make_scene():
    """A small body, larger than its template, in six poses, and its scans."""
    rng, template = np.random.default_rng(5), chain_body("linear", 10, 8)
    actor = scale_body(template, jnp.asarray(1.1))
    way = 0.02 * rng.normal(size=actor.skeleton.num_dofs)
    poses = [retract(actor.skeleton, rest_pose(actor.skeleton), jnp.asarray(n * way)) for n in range(FRAMES)]
    clouds = []
    for pose in poses:
        vertices = np.asarray(_posed(actor, pose).vertices, float)
        points, normals = sample_surface(vertices, np.asarray(actor.faces), POINTS, rng)
        clouds.append((points + 0.0005 * rng.normal(size=points.shape), normals))
    return template, actor, poses, clouds


def write_folder(folder, scene):
    """Into a folder: `body.npz`, the template, and `scan_0000.ply`, ..."""
    template, _, _, clouds = scene
    jc.save_body(folder / "body.npz", template)
    for number, (points, normals) in enumerate(clouds):
        write_scan(folder, number, points, normals)
    write_cameras(folder / "cameras.json", RING)
    return folder


def write_scan(folder, number: int, points, normals) -> None:
    views, faces = np.zeros(len(points), int), np.zeros((0, 3), int)
    write_ply(folder / f"scan_{number:04d}.ply", points, normals, views, faces)


def words(folder, *more) -> tuple:
    return "adapt", folder / "body.npz", folder / "*.ply", "-o", folder / "a.npz", *more


def task_of(scene, **changes) -> AdaptTask:
    template, _, poses, clouds = scene
    prior = RestPrior(jnp.full((template.skeleton.num_joints, 3), 0.7))
    settings = AdaptSettings(num_frames=3, proportion_rounds=1, rounds=(1,))
    whole = [jc.make_cloud(*cloud) for cloud in clouds]
    return AdaptTask(template, whole.__getitem__, FRAMES, 10.0, poses[0], prior, (), settings)._replace(
        **changes
    )
