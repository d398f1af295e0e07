"""Joints between two segments, by any of the methods, with one interface."""

from collections.abc import Callable
from typing import Literal

import numpy as np

from ...geometry.linear import inverse_symmetric, solve_symmetric
from ..segments.relative_motion import Relative
from .axis_sara import Hinge, find_hinge
from .centre_estimate import Centre
from .centre_score import score_centre
from .gamage import gamage_centre
from .joint import Joint
from .precision import arc_bound, principal, swept_arc
from .sphere import sphere_centre

#: `sphere` is the paper's method, `score` Ehrig's symmetrical one, `gamage` the closed form for common
#: spheres
Method = Literal["sphere", "score", "gamage"]
#: largest distance of a centre from the midpoint of the nearest markers, as a multiple of their distance
FAR = 1.5
METHODS: dict[str, Callable[[Relative], Centre]] = {
    "sphere": sphere_centre,
    "score": score_centre,
    "gamage": gamage_centre,
}


def find_joint(relative: Relative, parent: int, child: int, method: Method = "score") -> Joint:
    """Estimate the joint between two segments: centre by `method`, hinge axis (SARA), residual and precision.

    A child with fewer than three markers has no frame of its own. Then spheres replace SCoRE, and `in_child`
    is not known (NaN).

    **Raises:** `ValueError` for a method that does not exist.
    """
    if method not in METHODS:
        raise ValueError(f"There is no method '{method}' for centres; expected one of {', '.join(METHODS)}.")
    used = method if relative.turns or method != "score" else "gamage"
    centre = _without_noise(METHODS[used](relative), relative)
    hinge = None
    if relative.rotations is not None:
        hinge = find_hinge(relative.rotations)
        hinge = hinge if hinge.is_hinge else None
    if hinge is not None and centre.in_child is not None:
        centre = _along_axis(centre, relative, hinge)
    tracks = [relative.tracks[seen, n] for n, seen in enumerate(relative.tracked.T)]
    arcs = [swept_arc(track, centre.in_parent) for track in tracks]
    bounds = [
        arc_bound(np.linalg.norm(track - centre.in_parent, axis=1), arc)
        for track, arc in zip(tracks, arcs, strict=True)
    ]
    deviations, directions = principal(centre.covariance)
    return Joint(
        parent=parent,
        child=child,
        in_parent=centre.in_parent,
        in_child=np.full(3, np.nan) if centre.in_child is None else centre.in_child,
        axis_in_parent=None if hinge is None else hinge.in_parent,
        axis_in_child=None if hinge is None else hinge.in_child,
        residual=joint_residual(relative, centre.in_parent, centre.in_child),
        precision=deviations,
        directions=directions,
        bound=min(bounds),
        swept=max(arcs) if hinge is None else max(*arcs, hinge.swept),
        method=used,
    )


def joint_residual(relative: Relative, in_parent: np.ndarray, in_child: np.ndarray | None) -> float:
    """Compute the root mean square distance between the centre as the two segments carry it, metres.

    For a child without a frame it is that of its markers from their spheres, times root three, as it is one
    of three coordinates. The worst 5 % of the frames, which may be swaps, are left out.
    """
    if in_child is not None and relative.rotations is not None and relative.translations is not None:
        carried = np.einsum("fab,b->fa", relative.rotations, in_child) + relative.translations
        squares = np.sum((carried - in_parent) ** 2, 1)
        return float(np.sqrt(_trimmed(squares)))
    squares = []
    for n, seen in enumerate(relative.tracked.T):
        distances = np.linalg.norm(relative.tracks[seen, n] - in_parent, axis=1)
        squares.append(_trimmed((distances - np.median(distances)) ** 2))
    return float(np.sqrt(3 * np.average(squares, weights=relative.weights)))


def _without_noise(centre: Centre, relative: Relative) -> Centre:
    """Reduce the information on a centre by the share that is only noise.

    Frames with a rotation noise of half a degree seem to rotate by half a degree about the centroid of their
    markers, even at rest. If little information remains the centre moves to its prior.
    """
    if relative.rotations is not None:
        mean = relative.rotations.mean(0)
        values, vectors = np.linalg.eigh(np.eye(3) - mean @ mean.T)
        false = np.full(3, 2 * sum(relative.turn_noise))
    else:
        spreads = [np.cov(relative.tracks[s, n].T) for n, s in enumerate(relative.tracked.T)]
        values, vectors = np.linalg.eigh(np.average(spreads, axis=0, weights=relative.weights))
        false = np.full(3, relative.track_noise)
    # the noise level is known to a factor only: below three times it nothing is a rotation
    shares = np.clip(1 - 3 * false / np.maximum(values, 1e-300), 0.0, 1.0)
    shares = np.where(false > 0, shares, 1.0)
    known = inverse_symmetric(centre.covariance + 1e-16 * np.eye(3))
    root = vectors @ np.diag(np.sqrt(shares)) @ vectors.T
    left = root @ known @ root
    prior = np.eye(3) / relative.spread**2
    shift = solve_symmetric(left + prior, prior @ (relative.middle - centre.in_parent))
    if np.linalg.norm(shift) < 1e-9:
        shift = np.zeros(3)
    in_parent = centre.in_parent + shift
    if relative.rotations is None and np.linalg.norm(in_parent - relative.middle) > FAR * relative.spread:
        # spheres of nearly flat tracks have arbitrary centres: no information
        return Centre(relative.middle, None, relative.spread**2 * np.eye(3))
    in_child = centre.in_child
    if in_child is not None and relative.rotations is not None and relative.translations is not None:
        carried = np.einsum("fba,fb->fa", relative.rotations, in_parent - relative.translations)
        in_child = np.median(carried, axis=0) if shift.any() else in_child
    return Centre(in_parent, in_child, inverse_symmetric(left + prior))


def _trimmed(squares: np.ndarray) -> float:
    return float(np.sort(squares)[: max(1, round(0.95 * len(squares)))].mean())


def _along_axis(centre: Centre, relative: Relative, hinge: Hinge) -> Centre:
    """Move the centre of a hinge along its axis to the point that is nearest to the prior.

    The wobble of a hinge is not evidence for the position along its axis.
    """
    assert centre.in_child is not None and relative.rotations is not None
    along = float((relative.middle - centre.in_parent) @ hinge.in_parent)
    off = np.eye(3) - np.outer(hinge.in_parent, hinge.in_parent)
    covariance = off @ centre.covariance @ off
    covariance = covariance + relative.spread**2 * np.outer(hinge.in_parent, hinge.in_parent)
    return Centre(
        centre.in_parent + along * hinge.in_parent, centre.in_child + along * hinge.in_child, covariance
    )
