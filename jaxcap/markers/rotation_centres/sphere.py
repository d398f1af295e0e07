"""Spheres and circles through the tracks of single markers, and their common centre (the paper's method)."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from ...fit.alternate import iterate_until_converged
from ...geometry import linear
from ..segments.relative_motion import RelativeMotion
from .centre_precision import independent_frame_fraction
from .estimator_parts import MAX_REWEIGHTINGS, CentreEstimate, geman_mcclure_weights
from .sphere_problem import solve_sphere

#: number of grid cells along the longest side of a trajectory's bounding box, for densities
NUM_CELLS = 6
#: a trajectory is flat if its third singular value is below this share of its second
FLATNESS_RATIO = 0.12
#: lower limit of a trajectory's residual deviation, metres
MIN_DEVIATION = 1e-5


class FittedSphere(NamedTuple):
    """A sphere, or a circle with the normal of its plane, fitted to a trajectory."""

    centre: Float[np.ndarray, "3"]
    radius: float
    #: unit normal of a circle's plane; None for a sphere
    normal: Float[np.ndarray, "3"] | None
    #: root mean square distance from the surface, or from the circle, metres
    residual: float
    #: information matrix of the centre, 1/m²
    information: Float[np.ndarray, "3 3"]


class _SphereState(NamedTuple):
    """A sphere's centre and radius, and the weights of positions and prior for the next iteration."""

    parameters: np.ndarray
    weights: np.ndarray
    variance: float
    independent_fraction: float
    ridge: float


def density_weights(track: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F"]:
    """Weight positions by the inverse density on a grid over the trajectory's bounding box.

    The mean weight is one. So rare extreme poses count as much as frequent ones (Silaghi et al. 1998).
    """
    low, size = track.min(0), np.ptp(track, axis=0)
    # cells are cubes, so that a flat trajectory is not divided along its noise
    edge = max(float(size.max()) / NUM_CELLS, 1e-12)
    cells = np.minimum(((track - low) / edge).astype(int), NUM_CELLS - 1)
    _, place, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    weights = 1.0 / counts[place.ravel()]
    return weights / weights.mean()


def fit_sphere(
    track: Float[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "F"],
    prior_centre: Float[np.ndarray, "3"],
    prior_deviation: float,
    robust: bool = True,
) -> FittedSphere:
    """Fit a sphere by minimising the sum of `(|v - c| - r)^2`.

    The fit is geometric, so it lacks the bias of the algebraic fit. Levenberg-Marquardt starts from
    `prior_centre`, which with `prior_deviation` is also a weak prior of the centre. The weights of outliers
    and of the prior are updated until convergence.
    """

    def offsets(x):
        return np.linalg.norm(track - x[:3], axis=1) - x[3]

    def slopes(x):
        away = track - x[:3]
        units = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        return np.concatenate([-units, -np.ones((len(track), 1))], 1)

    def step(fit: _SphereState) -> _SphereState:
        found = solve_sphere(track, fit.weights, prior_centre, fit.ridge, fit.parameters)
        off = offsets(found)
        updated = weights * geman_mcclure_weights(np.abs(off)) if robust else weights
        variance, share = float(updated @ off**2 / updated.sum()), independent_frame_fraction(off[:, None])
        ridge = max(variance / (share * prior_deviation**2), 1e-10 * updated.sum())
        return _SphereState(found, updated, variance, share, ridge)

    radius = weights @ np.linalg.norm(track - prior_centre, axis=1) / weights.sum()
    fit = iterate_until_converged(
        step,
        _SphereState(np.append(prior_centre, radius), weights, prior_deviation**2, 1.0, 0.0),
        MAX_REWEIGHTINGS,
        1e-9,
    )
    rows, off = slopes(fit.parameters), offsets(fit.parameters)
    matrix = np.einsum("f,fa,fb->ab", fit.weights, rows, rows)
    # the radius is unknown, too
    normal = matrix[:3, :3] - np.outer(matrix[:3, 3], matrix[3, :3]) / matrix[3, 3]
    residual = float(np.sqrt(weights @ off**2 / weights.sum()))
    information = fit.independent_fraction * normal / max(fit.variance, MIN_DEVIATION**2)
    return FittedSphere(fit.parameters[:3], float(fit.parameters[3]), None, residual, information)


def fit_circle(
    track: Float[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "F"],
    prior_deviation: float,
    robust: bool = True,
) -> FittedSphere:
    """Fit a circle geometrically in the trajectory's best plane (least squares of the distances to it).

    Its centre is a point of the axis. It does not determine the position of the joint along the axis.
    """
    mean = weights @ track / weights.sum()
    _, _, axes = np.linalg.svd((track - mean) * np.sqrt(weights)[:, None], full_matrices=False)
    flat = np.stack([(track - mean) @ axes[0], (track - mean) @ axes[1], np.zeros(len(track))], 1)
    # an algebraic start: the local minimum of a short arc may be on the wrong side
    rows = np.concatenate([2 * flat[:, :2], np.ones((len(flat), 1))], 1)
    root = np.sqrt(weights)
    start = linear.least_squares(rows * root[:, None], np.sum(flat**2, 1) * root)
    start = np.array([*start[:2], 0.0])
    reach = np.linalg.norm(start)
    if reach > 4 * prior_deviation:
        start *= 4 * prior_deviation / reach
    ball = fit_sphere(flat, weights, start, prior_deviation, robust)
    out = (track - mean) @ axes[2]
    frame = axes.copy()
    information = ball.information.copy()
    # no information along the axis
    information[2], information[:, 2] = 0.0, 0.0
    residual = float(np.hypot(ball.residual, np.sqrt(weights @ out**2 / weights.sum())))
    centre = mean + ball.centre[0] * axes[0] + ball.centre[1] * axes[1]
    return FittedSphere(centre, ball.radius, axes[2], residual, frame.T @ information @ frame)


def fit_sphere_or_circle(
    track: Float[np.ndarray, "F 3"],
    prior_centre: Float[np.ndarray, "3"],
    prior_deviation: float,
    robust: bool = True,
) -> FittedSphere:
    """Fit a circle where the trajectory is flat, otherwise a sphere, with inverse-density weights."""
    weights = density_weights(track)
    values = np.linalg.svd(track - track.mean(0), compute_uv=False)
    flat = values[2] < FLATNESS_RATIO * values[1] or values[2] < 1e-9
    return (
        fit_circle(track, weights, prior_deviation, robust)
        if flat
        else fit_sphere(track, weights, prior_centre, prior_deviation, robust)
    )


def combine_centres(
    spheres: list[FittedSphere],
    weights: Float[np.ndarray, "N"],
    prior_centre: Float[np.ndarray, "3"],
    prior_deviation: float,
    weighting: Literal["information", "radius"] = "information",
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Combine centre estimates by their information matrices (1/m²).

    With `"radius"` it is the paper's mean, weighted by each marker's weight over its radius. Its formula is
    lost, and a single weight cannot express that a short arc determines one direction only. So by default
    each centre has its own information matrix, times the marker's weight.
    """
    if weighting == "radius":
        shares = weights / np.array([max(ball.radius, 1e-9) for ball in spheres])
        shares = shares / shares.sum()
        centre = shares @ np.stack([ball.centre for ball in spheres])
        return centre, sum((ball.information for ball in spheres), np.eye(3) / prior_deviation**2)
    total, side = np.eye(3) / prior_deviation**2, prior_centre / prior_deviation**2
    for ball, weight in zip(spheres, weights, strict=True):
        total = total + weight * ball.information
        side = side + weight * ball.information @ ball.centre
    return linear.solve_symmetric(total, side), total


def sphere_centre(
    motion: RelativeMotion, robust: bool = True, weighting: Literal["information", "radius"] = "information"
) -> CentreEstimate:
    """Estimate the paper's centre from spheres of the child's markers in the parent's frame.

    Where the child's frame is known, spheres of the parent's markers in it are added (Silaghi et al. 1998).
    """
    centre, known = _centre_in_frame(motion, robust, weighting)
    if motion.rotations is None or motion.translations is None:
        return CentreEstimate(centre, None, linear.inverse_symmetric(known))
    r, t = motion.rotations, motion.translations
    other, its = _centre_in_frame(motion.flipped(), robust, weighting)
    carried = np.median(np.einsum("fab,b->fa", r, other) + t, axis=0)
    its = np.mean(r @ its @ r.swapaxes(-1, -2), axis=0)
    centre = centre + linear.solve_symmetric(known + its, its @ (carried - centre))
    back = np.einsum("fba,fb->fa", r, centre - t)
    return CentreEstimate(centre, np.median(back, axis=0), linear.inverse_symmetric(known + its))


def _centre_in_frame(motion: RelativeMotion, robust: bool, weighting) -> tuple[np.ndarray, np.ndarray]:
    balls = [
        fit_sphere_or_circle(
            motion.child_markers[seen, n], motion.prior_centre, motion.prior_deviation, robust
        )
        for n, seen in enumerate(motion.child_visible.T)
    ]
    return combine_centres(
        balls, motion.child_weights, motion.prior_centre, motion.prior_deviation, weighting
    )
