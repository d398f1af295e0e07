"""The crane capture (Vlasic et al. 2008): frames, a body rigged from one of them, and clouds."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxcap.body.body import Body
from jaxcap.geometry.mesh import vertex_normals
from jaxcap.observe.clouds import Cloud
from jaxcap.rigging.rig_mesh import rig_mesh

#: he stands upright in the first frame, arms off the body
RIGGED_FRAME = 0


class Crane(NamedTuple):
    """A real subject: 175 frames of one mesh at 30 frames per second; vertex `i` is the same point in all."""

    frames: Float[np.ndarray, "F V 3"]
    faces: Int[np.ndarray, "T 3"]


def load_crane(shared: Path) -> Crane:
    """Load the frames, metres, y up; `shared` is the folder of captures."""
    with np.load(shared / "data" / "meshes" / "crane.npz", allow_pickle=False) as file:
        return Crane(file["vertices"].astype(np.float32), file["faces"].astype(np.int32))


def rig_crane(crane: Crane, frame: int = RIGGED_FRAME) -> Body:
    """Rig the subject's body from one frame, its rest pose, with the vertices of the capture in their order."""
    return rig_mesh(crane.frames[frame], crane.faces)


def frame_cloud(crane: Crane, frame: int, count: int = 5000, seed: int = 0) -> Cloud:
    """Sample `count` vertices of a frame with their normals, in random order, without correspondences."""
    chosen = np.random.default_rng([seed, frame]).permutation(crane.frames.shape[1])[:count]
    vertices = jnp.asarray(crane.frames[frame])
    normals = vertex_normals(vertices, jnp.asarray(crane.faces))
    return Cloud(vertices[chosen], normals[chosen], jnp.ones(len(chosen), vertices.dtype))


def true_distances(crane: Crane, frame: int, vertices: Float[Array, "V 3"]) -> Float[np.ndarray, "V"]:
    """Compute the distance of each vertex of a posed body from the same vertex of a frame, metres."""
    return np.linalg.norm(np.asarray(vertices) - crane.frames[frame], axis=1)
