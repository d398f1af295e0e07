"""Checks that the joints of a learned skeleton can be those of a body."""

import numpy as np
from jaxtyping import Float, Int

from ...body.body import Body
from ...errors import join_names
from ...metrics import scan_to_surface

#: the least winding number of the surface around a joint in the body; it is one inside of a closed surface, zero outside
MIN_WINDING = 0.5


def check_skeleton(body: Body) -> list[str]:
    """Return one sentence about joints outside of the surface at rest, and one about joints that are closer than a limb is wide.

    The width of a limb at a joint is twice the distance from the joint to the surface. Joints that do not rotate are ignored.
    """
    skeleton = body.skeleton
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    rows = [j for j, parent in enumerate(skeleton.parents) if parent >= 0 and skeleton.kinds[j] != "fixed"]
    centres = np.asarray(skeleton.centres, float)
    windings = np.abs(winding_numbers(centres[rows], vertices, faces))
    outside = [skeleton.names[j] for j, winding in zip(rows, windings, strict=True) if winding < MIN_WINDING]
    messages = (
        [f"{join_names(outside)} {'is' if len(outside) == 1 else 'are'} outside of the body."]
        if outside
        else []
    )
    widths = 2 * scan_to_surface(centres, vertices, faces)
    near = [
        f"{skeleton.names[skeleton.parents[j]]} and {skeleton.names[j]} "
        f"({1000 * np.linalg.norm(centres[j] - centres[skeleton.parents[j]]):.0f} mm)"
        for j in rows
        if skeleton.parents[j] in rows
        and np.linalg.norm(centres[j] - centres[skeleton.parents[j]])
        < min(widths[j], widths[skeleton.parents[j]])
    ]
    if near:
        messages.append(
            f"Joints are closer to each other than the limb is wide: {join_names(near)}; they may be one joint of a body; "
            "give fewer joints."
        )
    return messages


def winding_numbers(
    points: Float[np.ndarray, "N 3"], vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "T 3"]
) -> Float[np.ndarray, "N"]:
    """Compute how often a surface winds around points (Jacobson et al. 2013), by the solid angles of its triangles.

    The solid angle of a triangle is that of Van Oosterom and Strackee (1983).
    """
    found = np.zeros(len(points))
    for number, point in enumerate(points):
        a, b, c = np.moveaxis(vertices[faces] - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("ta,ta->t", a, np.cross(b, c))
        dots = (np.sum(a * b, 1) * lc, np.sum(b * c, 1) * la, np.sum(c * a, 1) * lb)
        found[number] = 2 * np.arctan2(volume, la * lb * lc + sum(dots)).sum() / (4 * np.pi)
    return found
