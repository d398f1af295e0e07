"""Rigging of a mesh: one entry point for all methods."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int, Integer

from ..arguments import checked
from ..body.body import Body
from ..body.skeleton import Skeleton
from ..body.skin import AbstractSkin, LinearSkin, RigidSkin
from ..errors import InputError
from ..geometry.mesh import area_normals
from .envelopes import assign_bones, default_radii, default_tails
from .heat import heat_weights
from .place_skeleton import place_human

METHODS = ("automatic", "envelopes", "heat")


@checked
def rig_mesh(
    vertices: Float[np.ndarray, "V 3"],
    faces: Integer[np.ndarray, "F 3"],
    skeleton: Skeleton | None = None,
    method: Literal["automatic", "envelopes", "heat"] = "automatic",
    *,
    tails: Float[np.ndarray, "J 3"] | None = None,
    radii: Float[np.ndarray, "J"] | None = None,
    up: Literal["x", "y", "z"] = "y",
) -> Body:
    """Bind a mesh to a skeleton; the given mesh becomes the rest pose of the body.

    **Arguments:** `vertices` metres, `faces` counter-clockwise from outside. `skeleton` is aligned with
    the mesh; if None, the human skeleton is placed in the mesh (`place_human`). `method` determines the
    skinning:

    - "automatic": the weights of the placed human body; or, for a given skeleton, as "heat".
    - "envelopes": every vertex rigidly with one bone (`assign_bones`), by `tails` and `radii`,
      metres, or by `default_tails` and `default_radii`.
    - "heat": smooth bone heat weights (`heat_weights`); `tails` as above, and a bone of radius zero in
      `radii` moves no vertex.

    `up` is the axis of a placed human that points up.

    **Raises:** `InputError` if the mesh is invalid, if a vertex lies in no envelope, or if no human is found
    in the mesh.
    """
    if method not in METHODS:
        raise InputError(f"The rigging method '{method}' is unknown; give one of {', '.join(METHODS)}.")
    vertices, faces = np.asarray(vertices, float), np.asarray(faces, np.int32)
    _check_mesh(vertices, faces)
    if skeleton is None:
        placed = place_human(vertices, faces, up)
        if method == "automatic":
            return placed
        skeleton = placed.skeleton
    tails = default_tails(skeleton) if tails is None else tails
    skin: AbstractSkin
    if method == "envelopes":
        radii = default_radii(vertices, skeleton, tails) if radii is None else radii
        skin = RigidSkin(jnp.asarray(assign_bones(vertices, skeleton, tails, radii)))
    else:
        deforming = None if radii is None else radii > 0
        weights = heat_weights(vertices, faces, skeleton, tails, deforming)
        skin = LinearSkin(jnp.asarray(weights, skeleton.centres.dtype))
    return Body(skeleton, skin, jnp.asarray(vertices, skeleton.centres.dtype), jnp.asarray(faces))


def _check_mesh(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> None:
    if len(vertices) == 0 or len(faces) == 0:
        raise InputError(
            f"The mesh has {len(vertices)} vertices and {len(faces)} triangles; expected a mesh with a surface."
        )
    wrong = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
    if len(wrong):
        raise InputError(
            f"Vertex {wrong[0]} is at {vertices[wrong[0]].tolist()}; give every vertex three finite numbers."
        )
    wrong = np.flatnonzero(((faces < 0) | (faces >= len(vertices))).any(axis=1))
    if len(wrong):
        raise InputError(
            f"Triangle {wrong[0]} has the vertices {faces[wrong[0]].tolist()}; expected 0 to "
            f"{len(vertices) - 1}; correct the triangle or leave it out."
        )
    if not area_normals(vertices[faces]).any():
        raise InputError("All triangles of the mesh have zero area; give a mesh with a surface.")
