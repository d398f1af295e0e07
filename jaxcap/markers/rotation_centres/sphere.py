"""Spheres and circles on which single markers move, and the centre they have in common (the paper's way)."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from ...geometry import linear
from ..segments.relative_motion import Relative
from .centre_estimate import ROUNDS, Centre, robust_weights, settle
from .precision import independent_share

#: boxes along each side of the least box around a trajectory, by whose points densities are taken
BOXES = 6
#: a trajectory is flat where it leaves its best plane by less than this share of how far it leaves a line
FLAT = 0.12
#: no trajectory is trusted to be more exact than this, metres
EXACT = 1e-5
#: where a fit ends, relative: as near to the minimum as rounding allows
EXACTLY = 1e-15


class Ball(NamedTuple):
    """A sphere, or a circle with its plane's normal, laid on a trajectory."""

    centre: Float[np.ndarray, "3"]
    radius: float
    #: unit normal of a circle's plane; None of a sphere
    normal: Float[np.ndarray, "3"] | None
    #: root mean square of the distances from the surface, or from the circle, metres
    residual: float
    #: what the trajectory tells of the centre, one over metres squared
    information: Float[np.ndarray, "3 3"]


class _Fit(NamedTuple):
    """A sphere's centre and radius, and what the next round weighs places and the prior by."""

    found: np.ndarray
    weights: np.ndarray
    variance: float
    share: float
    hold: float


def density_weights(track: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F"]:
    """Weights inverse to how many places lie in a place's box of a grid over the trajectory's least
    box, mean one: rare extreme poses count as much as the rest (Silaghi et al. 1998)."""
    low, size = track.min(0), np.ptp(track, axis=0)
    # boxes are cubes, so that a flat trajectory is not cut along its noise
    edge = max(float(size.max()) / BOXES, 1e-12)
    cells = np.minimum(((track - low) / edge).astype(int), BOXES - 1)
    _, place, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    weights = 1.0 / counts[place.ravel()]
    return weights / weights.mean()


def fit_sphere(
    track: Float[np.ndarray, "F 3"],
    weights: Float[np.ndarray, "F"],
    middle: Float[np.ndarray, "3"],
    spread: float,
    robust: bool = True,
) -> Ball:
    """The sphere with the least sum of `(|v - c| - r)^2`: geometric, so that it is not drawn to the data
    as the algebraic fit is. Levenberg-Marquardt (MINPACK's) from `middle`, which with `spread` also is a weak
    prior of the centre; places that fit badly and the prior are weighed anew until that settles."""

    def offsets(x):
        return np.linalg.norm(track - x[:3], axis=1) - x[3]

    def slopes(x):
        away = track - x[:3]
        units = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        return np.concatenate([-units, -np.ones((len(track), 1))], 1)

    def step(fit: _Fit) -> _Fit:
        root, held = np.sqrt(fit.weights), np.sqrt(fit.hold)
        found = least_squares(
            lambda x: np.append(root * offsets(x), held * (x[:3] - middle)),
            fit.found,
            lambda x: np.concatenate([root[:, None] * slopes(x), held * np.eye(3, 4)]),  # pyright: ignore[reportArgumentType]
            method="lm",
            xtol=EXACTLY,
            ftol=EXACTLY,
            gtol=EXACTLY,
        ).x
        off = offsets(found)
        own = weights * robust_weights(np.abs(off)) if robust else weights
        variance, share = float(own @ off**2 / own.sum()), independent_share(off[:, None])
        hold = max(variance / (share * spread**2), 1e-10 * own.sum())
        return _Fit(found, own, variance, share, hold)

    radius = weights @ np.linalg.norm(track - middle, axis=1) / weights.sum()
    fit = settle(step, _Fit(np.append(middle, radius), weights, spread**2, 1.0, 0.0), ROUNDS, 1e-9)
    rows, off = slopes(fit.found), offsets(fit.found)
    matrix = np.einsum("f,fa,fb->ab", fit.weights, rows, rows)
    # the radius is unknown, too
    normal = matrix[:3, :3] - np.outer(matrix[:3, 3], matrix[3, :3]) / matrix[3, 3]
    residual = float(np.sqrt(weights @ off**2 / weights.sum()))
    information = fit.share * normal / max(fit.variance, EXACT**2)
    return Ball(fit.found[:3], float(fit.found[3]), None, residual, information)


def fit_circle(
    track: Float[np.ndarray, "F 3"], weights: Float[np.ndarray, "F"], spread: float, robust: bool = True
) -> Ball:
    """The circle in the trajectory's best plane (least squares of the distances from the plane), fitted
    geometrically. Its centre is a point of the axis; where along the axis the joint is, it does not tell.
    """
    mean = weights @ track / weights.sum()
    _, _, axes = np.linalg.svd((track - mean) * np.sqrt(weights)[:, None], full_matrices=False)
    flat = np.stack([(track - mean) @ axes[0], (track - mean) @ axes[1], np.zeros(len(track))], 1)
    # an algebraic start: with short arcs the nearest centre may be on the wrong side
    rows = np.concatenate([2 * flat[:, :2], np.ones((len(flat), 1))], 1)
    root = np.sqrt(weights)
    start = linear.least_squares(rows * root[:, None], np.sum(flat**2, 1) * root)
    start = np.array([*start[:2], 0.0])
    reach = np.linalg.norm(start)
    if reach > 4 * spread:
        start *= 4 * spread / reach
    ball = fit_sphere(flat, weights, start, spread, robust)
    out = (track - mean) @ axes[2]
    frame = axes.copy()
    information = ball.information.copy()
    # nothing along the axis
    information[2], information[:, 2] = 0.0, 0.0
    residual = float(np.hypot(ball.residual, np.sqrt(weights @ out**2 / weights.sum())))
    centre = mean + ball.centre[0] * axes[0] + ball.centre[1] * axes[1]
    return Ball(centre, ball.radius, axes[2], residual, frame.T @ information @ frame)


def fit_ball(
    track: Float[np.ndarray, "F 3"],
    middle: Float[np.ndarray, "3"],
    spread: float,
    robust: bool = True,
) -> Ball:
    """A circle where the trajectory is flat, else a sphere; with inverse-density weights."""
    weights = density_weights(track)
    values = np.linalg.svd(track - track.mean(0), compute_uv=False)
    flat = values[2] < FLAT * values[1] or values[2] < 1e-9
    return (
        fit_circle(track, weights, spread, robust)
        if flat
        else fit_sphere(track, weights, middle, spread, robust)
    )


def combine(
    balls: list[Ball],
    weights: Float[np.ndarray, "N"],
    middle: Float[np.ndarray, "3"],
    spread: float,
    by: Literal["information", "radius"] = "information",
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """One centre of several, and what is known of it, one over metres squared.

    With `"radius"` the paper's: the mean weighted by each marker's weight over its radius. Its formula
    is lost, and no one number can say that a short arc tells one direction only, so by default each
    centre counts by its own information, times the marker's weight.
    """
    if by == "radius":
        shares = weights / np.array([max(ball.radius, 1e-9) for ball in balls])
        shares = shares / shares.sum()
        centre = shares @ np.stack([ball.centre for ball in balls])
        return centre, sum((ball.information for ball in balls), np.eye(3) / spread**2)
    total, side = np.eye(3) / spread**2, middle / spread**2
    for ball, weight in zip(balls, weights, strict=True):
        total = total + weight * ball.information
        side = side + weight * ball.information @ ball.centre
    return linear.solve_symmetric(total, side), total


def sphere_centre(
    relative: Relative, robust: bool = True, by: Literal["information", "radius"] = "information"
) -> Centre:
    """The paper's centre: spheres of the child's markers in the parent's frame, and, where the child's
    frame is known, also of the parent's markers in the child's, all combined (Silaghi et al. 1998)."""
    centre, known = _one_side(relative, robust, by)
    if relative.rotations is None or relative.translations is None:
        return Centre(centre, None, linear.inverse_symmetric(known))
    r, t = relative.rotations, relative.translations
    other, its = _one_side(relative.flipped(), robust, by)
    carried = np.median(np.einsum("fab,b->fa", r, other) + t, axis=0)
    its = np.mean(r @ its @ r.swapaxes(-1, -2), axis=0)
    centre = centre + linear.solve_symmetric(known + its, its @ (carried - centre))
    back = np.einsum("fba,fb->fa", r, centre - t)
    return Centre(centre, np.median(back, axis=0), linear.inverse_symmetric(known + its))


def _one_side(relative: Relative, robust: bool, by) -> tuple[np.ndarray, np.ndarray]:
    balls = [
        fit_ball(relative.tracks[seen, n], relative.middle, relative.spread, robust)
        for n, seen in enumerate(relative.tracked.T)
    ]
    return combine(balls, relative.weights, relative.middle, relative.spread, by)
