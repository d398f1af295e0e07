"""Rigid assignment of vertices to bones by envelopes: a capsule of some radius around every bone."""

import numpy as np
from jaxtyping import Float, Int

from ..body.skeleton import Skeleton
from ..errors import InputError

#: ratio of a default envelope's radius to the distance of its farthest vertex
MARGIN = 1.05
#: the length of a last bone, as a share of the bone before it
TIP = 0.5


def default_tails(skeleton: Skeleton) -> Float[np.ndarray, "J 3"]:
    """Estimate the tail of each bone, metres: the mean of its child joints at other positions.

    A last bone continues the direction of its parent with half the length.
    """
    centres = np.asarray(skeleton.centres, float)
    parents = np.array(skeleton.parents)
    tails = centres.copy()
    for joint, parent in enumerate(skeleton.parents):
        children = centres[parents == joint]
        distinct = children[np.linalg.norm(children - centres[joint], axis=1) > 0]
        if len(distinct):
            tails[joint] = distinct.mean(0)
        elif parent >= 0:
            tails[joint] += TIP * (centres[joint] - centres[parent])
    return tails


def bone_distances(
    vertices: Float[np.ndarray, "V 3"], heads: Float[np.ndarray, "J 3"], tails: Float[np.ndarray, "J 3"]
) -> tuple[Float[np.ndarray, "V J"], Float[np.ndarray, "V J 3"]]:
    """Compute the distance of each vertex from each bone, metres, and the closest point on the bone."""
    along = tails - heads
    squared = np.sum(along * along, axis=1)
    share = np.einsum("vja,ja->vj", vertices[:, None] - heads, along) / np.where(squared > 0, squared, 1.0)
    feet = heads + np.clip(share, 0.0, 1.0)[:, :, None] * along
    return np.linalg.norm(vertices[:, None] - feet, axis=2), feet


def default_radii(
    vertices: Float[np.ndarray, "V 3"],
    skeleton: Skeleton,
    tails: Float[np.ndarray, "J 3"] | None = None,
) -> Float[np.ndarray, "J"]:
    """Compute radii, metres, so that every vertex lies in the envelope of its nearest bone.

    A bone that is nearest to no vertex has radius zero and no envelope. Bones without length, such as a root
    with three child joints at its own position, are spheres.
    """
    heads = np.asarray(skeleton.centres, float)
    distances, _ = bone_distances(vertices, heads, default_tails(skeleton) if tails is None else tails)
    nearest = distances.argmin(axis=1)
    radii = np.zeros(len(heads))
    np.maximum.at(radii, nearest, MARGIN * distances[np.arange(len(vertices)), nearest])
    return radii


def assign_bones(
    vertices: Float[np.ndarray, "V 3"],
    skeleton: Skeleton,
    tails: Float[np.ndarray, "J 3"] | None,
    radii: Float[np.ndarray, "J"],
) -> Int[np.ndarray, "V"]:
    """Assign every vertex to the bone in whose envelope it lies deepest (Kineben, A.7).

    An envelope is the capsule of a radius around a bone, from its joint's centre to its tail. Depth is the
    distance from the bone divided by the radius. A bone of radius zero has no envelope and no vertices; it
    does not deform the mesh.

    **Arguments:** `tails (J, 3)` metres, `default_tails` if None; `radii (J,)` metres.

    **Raises:** `InputError` if no envelope covers a vertex, with its position and the radius of the nearest
    bone that would cover it.
    """
    radii = np.asarray(radii, float)
    if (radii < 0).any() or not np.isfinite(radii).all() or not (radii > 0).any():
        raise InputError(
            "The radii of the envelopes are negative, not finite, or all zero; expected lengths in metres, zero "
            "for a bone without envelope, and at least one above zero."
        )
    tails = default_tails(skeleton) if tails is None else np.asarray(tails, float)
    distances, _ = bone_distances(vertices, np.asarray(skeleton.centres, float), tails)
    with_envelope = radii > 0
    depths = np.where(with_envelope, distances / np.where(with_envelope, radii, 1.0), np.inf)
    bones = depths.argmin(axis=1)
    outside = np.flatnonzero(depths.min(axis=1) > 1)
    if len(outside):
        first = int(outside[0])
        near = int(np.where(with_envelope, distances[first], np.inf).argmin())
        others = f" and {len(outside) - 1} more" if len(outside) > 1 else ""
        place = ", ".join(f"{x:.4f}" for x in vertices[first])
        raise InputError(
            f"Vertex {first} at ({place}) m{others} is outside all envelopes; the nearest bone, "
            f"'{skeleton.names[near]}', has a radius of {radii[near]:.4f} m; increase it to at least "
            f"{distances[first, near]:.4f} m."
        )
    return bones
