"""Joints between two segments, by any of the methods, with one interface."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...geometry.linear import inverse_symmetric, solve_symmetric
from ..segments.relative_motion import RelativeMotion
from .axis_sara import Hinge, find_hinge
from .centre_precision import arc_bound, principal_deviations, swept_arc
from .centre_score import score_centre
from .estimator_parts import CentreEstimate
from .gamage import gamage_centre
from .joint import Joint
from .sphere import sphere_centre

#: `sphere` is the paper's method, `score` Ehrig's symmetrical one, `gamage` the closed form for common
#: spheres
CentreMethod = Literal["sphere", "score", "gamage"]
#: largest distance of a centre from the midpoint of the nearest markers, as a multiple of their distance
MAX_CENTRE_DISTANCE = 1.5
CENTRE_METHODS: dict[str, Callable[[RelativeMotion], CentreEstimate]] = {
    "sphere": sphere_centre,
    "score": score_centre,
    "gamage": gamage_centre,
}


def find_joint(motion: RelativeMotion, parent: int, child: int, method: CentreMethod = "score") -> Joint:
    """Estimate the joint between two segments: centre by `method`, hinge axis (SARA), residual and precision.

    A child with fewer than three markers has no frame of its own. Then spheres replace SCoRE, and `in_child`
    is not known (NaN).

    **Raises:** `ValueError` for a method that does not exist.
    """
    if method not in CENTRE_METHODS:
        raise ValueError(
            f"There is no method '{method}' for centres; expected one of {', '.join(CENTRE_METHODS)}."
        )
    used = method if motion.has_child_frame or method != "score" else "gamage"
    centre = _discount_noise(CENTRE_METHODS[used](motion), motion)
    hinge = None
    if motion.rotations is not None:
        hinge = find_hinge(motion.rotations)
        hinge = hinge if hinge.is_hinge else None
    if hinge is not None and centre.in_child is not None:
        centre = _move_along_axis(centre, motion, hinge)
    tracks = [motion.child_markers[seen, n] for n, seen in enumerate(motion.child_visible.T)]
    arcs = [swept_arc(track, centre.in_parent) for track in tracks]
    bounds = [
        arc_bound(np.linalg.norm(track - centre.in_parent, axis=1), arc)
        for track, arc in zip(tracks, arcs, strict=True)
    ]
    deviations, directions = principal_deviations(centre.covariance)
    return Joint(
        parent=parent,
        child=child,
        in_parent=centre.in_parent,
        in_child=np.full(3, np.nan) if centre.in_child is None else centre.in_child,
        axis_in_parent=None if hinge is None else hinge.in_parent,
        axis_in_child=None if hinge is None else hinge.in_child,
        residual=joint_residual(motion, centre.in_parent, centre.in_child),
        deviations=deviations,
        directions=directions,
        arc_bound=min(bounds),
        swept_angle=max(arcs) if hinge is None else max(*arcs, hinge.swept_angle),
        method=used,
    )


def joint_residual(motion: RelativeMotion, in_parent: np.ndarray, in_child: np.ndarray | None) -> float:
    """Compute the root mean square distance between the centre as the two segments carry it, metres.

    For a child without a frame it is that of its markers from their spheres, times root three, as it is one
    of three coordinates. The worst 5 % of the frames, which may be swaps, are left out.
    """
    if in_child is not None and motion.rotations is not None and motion.translations is not None:
        carried = np.einsum("fab,b->fa", motion.rotations, in_child) + motion.translations
        squares = np.sum((carried - in_parent) ** 2, 1)
        return float(np.sqrt(_trimmed_mean(squares)))
    squares = []
    for n, seen in enumerate(motion.child_visible.T):
        distances = np.linalg.norm(motion.child_markers[seen, n] - in_parent, axis=1)
        squares.append(_trimmed_mean((distances - np.median(distances)) ** 2))
    return float(np.sqrt(3 * np.average(squares, weights=motion.child_weights)))


def _discount_noise(centre: CentreEstimate, motion: RelativeMotion) -> CentreEstimate:
    """Reduce the information on a centre by the share that is only noise.

    Frames with a rotation noise of half a degree seem to rotate by half a degree about the centroid of their
    markers, even at rest. If little information remains the centre moves to its prior.
    """
    if motion.rotations is not None:
        mean = motion.rotations.mean(0)
        values, vectors = np.linalg.eigh(np.eye(3) - mean @ mean.T)
        false = np.full(3, 2 * sum(motion.rotation_noise))
    else:
        spreads = [np.cov(motion.child_markers[s, n].T) for n, s in enumerate(motion.child_visible.T)]
        values, vectors = np.linalg.eigh(np.average(spreads, axis=0, weights=motion.child_weights))
        false = np.full(3, motion.marker_noise)
    # the noise level is known to a factor only: below three times it nothing is a rotation
    shares = np.clip(1 - 3 * false / np.maximum(values, 1e-300), 0.0, 1.0)
    shares = np.where(false > 0, shares, 1.0)
    known = inverse_symmetric(centre.covariance + 1e-16 * np.eye(3))
    root = vectors @ np.diag(np.sqrt(shares)) @ vectors.T
    left = root @ known @ root
    prior = np.eye(3) / motion.prior_deviation**2
    shift = solve_symmetric(left + prior, prior @ (motion.prior_centre - centre.in_parent))
    if np.linalg.norm(shift) < 1e-9:
        shift = np.zeros(3)
    in_parent = centre.in_parent + shift
    if (
        motion.rotations is None
        and np.linalg.norm(in_parent - motion.prior_centre) > MAX_CENTRE_DISTANCE * motion.prior_deviation
    ):
        # spheres of nearly flat tracks have arbitrary centres: no information
        return CentreEstimate(motion.prior_centre, None, motion.prior_deviation**2 * np.eye(3))
    in_child = centre.in_child
    if in_child is not None and motion.rotations is not None and motion.translations is not None:
        carried = np.einsum("fba,fb->fa", motion.rotations, in_parent - motion.translations)
        in_child = np.median(carried, axis=0) if shift.any() else in_child
    return CentreEstimate(in_parent, in_child, inverse_symmetric(left + prior))


def _trimmed_mean(squares: np.ndarray) -> float:
    return float(np.sort(squares)[: max(1, round(0.95 * len(squares)))].mean())


def _move_along_axis(centre: CentreEstimate, motion: RelativeMotion, hinge: Hinge) -> CentreEstimate:
    """Move the centre of a hinge along its axis to the point that is nearest to the prior.

    The wobble of a hinge is not evidence for the position along its axis.
    """
    assert centre.in_child is not None and motion.rotations is not None
    along = float((motion.prior_centre - centre.in_parent) @ hinge.in_parent)
    off = np.eye(3) - np.outer(hinge.in_parent, hinge.in_parent)
    covariance = off @ centre.covariance @ off
    covariance = covariance + motion.prior_deviation**2 * np.outer(hinge.in_parent, hinge.in_parent)
    return CentreEstimate(
        centre.in_parent + along * hinge.in_parent, centre.in_child + along * hinge.in_child, covariance
    )
