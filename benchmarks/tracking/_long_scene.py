"""A small limb and its clouds in a periodic motion, for runs of any length."""

from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import trimesh

import jaxcap as jc
from jaxcap.io.meshes.mesh import Mesh, write_mesh

#: frames after which the motion repeats
PERIOD = 200
#: size of the limb, metres, and its vertices along and around it
LENGTH, RADIUS, NUM_RINGS, NUM_SIDES = 0.5, 0.05, 26, 16
NAMES = ("upper", "fore", "hand")

_pose_body = eqx.filter_jit(jc.pose_body)


def make_limb() -> jc.Body:
    """Make a tapering tube of 416 vertices on three bones."""
    along, around = np.meshgrid(
        np.linspace(0, LENGTH, NUM_RINGS), np.arange(NUM_SIDES) * 2 * np.pi / NUM_SIDES, indexing="ij"
    )
    radius = RADIUS * (1 - 0.4 * along / LENGTH) * (1 + 0.3 * np.cos(around))
    vertices = np.stack([radius * np.cos(around), along, radius * np.sin(around)], -1).reshape(-1, 3)
    corner = np.arange(NUM_RINGS * NUM_SIDES).reshape(NUM_RINGS, NUM_SIDES)
    a, b = corner[:-1], np.roll(corner, -1, 1)[:-1]
    c, d = corner[1:], np.roll(corner, -1, 1)[1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    centres = [[0, 0, 0], [0, LENGTH / 3, 0], [0, 2 * LENGTH / 3, 0]]
    skeleton = jc.make_skeleton(NAMES, (-1, 0, 1), ("free", "ball", "ball"), centres)
    # each third follows its bone, blended over a tenth of the length
    steps = 1 / (
        1 + np.exp(-(vertices[:, 1, None] - np.array([LENGTH / 3, 2 * LENGTH / 3])) / (0.02 * LENGTH))
    )
    weights = np.stack([1 - steps[:, 0], steps[:, 0] - steps[:, 1], steps[:, 1]], 1)
    return jc.Body(skeleton, jc.LinearSkin(jnp.asarray(weights)), jnp.asarray(vertices), jnp.asarray(faces))


def write_clouds(folder: Path, body: jc.Body, frames: int, points: int) -> str:
    """Clouds of so many frames, as files of which those a period apart are one on the disk; the pattern of their names."""
    rng, phase = np.random.default_rng(6), 2 * np.pi * np.arange(PERIOD) / PERIOD
    for frame in range(min(frames, PERIOD)):
        d = np.zeros(body.skeleton.num_dofs)
        # the root sways, and both joints bend about two axes
        d[:3] = 0.05 * np.sin(phase[frame]), 0.0, 0.03 * np.sin(2 * phase[frame])
        d[6:] = 0.4 * np.sin(phase[frame] + np.arange(6))
        pose = jc.retract(body.skeleton, jc.rest_pose(body.skeleton), jnp.asarray(d))
        surface = trimesh.Trimesh(
            np.asarray(_pose_body(body, pose).vertices), np.asarray(body.faces), process=False
        )
        places, triangles = trimesh.sample.sample_surface(surface, points, seed=frame)
        places = places + 0.002 * rng.normal(size=places.shape)
        cloud = Mesh(places, np.zeros((0, 3), int), np.asarray(surface.face_normals[triangles]))
        write_mesh(folder / f"cloud_{frame:06d}.ply", cloud)
    for frame in range(PERIOD, frames):
        (folder / f"cloud_{frame:06d}.ply").hardlink_to(folder / f"cloud_{frame % PERIOD:06d}.ply")
    return str(folder / "cloud_%06d.ply")
