"""Spheres and circles on which single markers move, and the centre they have in common (the paper's way)."""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from .common import ROUNDS, Centre, robust_weights
from .precision import independent_share
from .relative import Relative

#: boxes along each side of the least box around a trajectory, by whose points densities are taken
BOXES = 6
#: a trajectory is flat where it leaves its best plane by less than this share of how far it leaves a line
FLAT = 0.12
#: no trajectory is trusted to be more exact than this, metres
EXACT = 1e-5


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
    as the algebraic fit is. Gauss-Newton with damping from `middle`, which with `spread` also is a weak
    prior of the centre."""
    c = middle.copy()
    r = float(weights @ np.linalg.norm(track - c, axis=1) / weights.sum())
    own, variance, share, damping = weights.copy(), spread**2, 1.0, 1e-6
    hold = 0.0

    def cost(centre, radius):
        off = np.linalg.norm(track - centre, axis=1) - radius
        return float(own @ off**2) + hold * float(np.sum((centre - middle) ** 2)), off

    rows, step = np.zeros((len(track), 4)), np.zeros(4)
    for turn in range(8 * ROUNDS):
        now, off = cost(c, r)
        away = track - c
        units = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
        rows = np.concatenate([-units, -np.ones((len(track), 1))], 1)
        matrix = np.einsum("f,fa,fb->ab", own, rows, rows)
        side = -np.einsum("f,fa,f->a", own, rows, off)
        matrix[:3, :3] += hold * np.eye(3)
        side[:3] -= hold * (c - middle)
        while True:
            step = np.linalg.solve(matrix + damping * np.trace(matrix) * np.eye(4), side)
            if cost(c + step[:3], r + step[3])[0] <= now or damping > 1e6:
                break
            damping *= 10
        c, r, damping = c + step[:3], r + step[3], max(0.1 * damping, 1e-12)
        if turn % 6 == 5:
            off = np.linalg.norm(track - c, axis=1) - r
            if robust:
                own = weights * robust_weights(np.abs(off))
            variance = float(own @ off**2 / own.sum())
            share = independent_share(off[:, None])
            hold = max(variance / (share * spread**2), 1e-10 * own.sum())
        if turn > 6 and np.linalg.norm(step) < 1e-11:
            break
    off = np.linalg.norm(track - c, axis=1) - r
    variance = max(variance, EXACT**2)
    matrix = np.einsum("f,fa,fb->ab", own, rows, rows)
    # the radius is unknown, too
    normal = matrix[:3, :3] - np.outer(matrix[:3, 3], matrix[3, :3]) / matrix[3, 3]
    return Ball(c, r, None, float(np.sqrt(weights @ off**2 / weights.sum())), share * normal / variance)


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
    start = np.linalg.lstsq(rows * root[:, None], np.sum(flat**2, 1) * root, rcond=None)[0]
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
    return np.linalg.solve(total, side), total


def sphere_centre(
    relative: Relative, robust: bool = True, by: Literal["information", "radius"] = "information"
) -> Centre:
    """The paper's centre: spheres of the child's markers in the parent's frame, and, where the child's
    frame is known, also of the parent's markers in the child's, all combined (Silaghi et al. 1998)."""
    centre, known = _one_side(relative, robust, by)
    if relative.rotations is None or relative.translations is None:
        return Centre(centre, None, np.linalg.inv(known))
    r, t = relative.rotations, relative.translations
    other, its = _one_side(relative.flipped(), robust, by)
    carried = np.median(np.einsum("fab,b->fa", r, other) + t, axis=0)
    its = np.mean(r @ its @ r.swapaxes(-1, -2), axis=0)
    centre = centre + np.linalg.solve(known + its, its @ (carried - centre))
    back = np.einsum("fba,fb->fa", r, centre - t)
    return Centre(centre, np.median(back, axis=0), np.linalg.inv(known + its))


def _one_side(relative: Relative, robust: bool, by) -> tuple[np.ndarray, np.ndarray]:
    balls = [
        fit_ball(relative.tracks[seen, n], relative.middle, relative.spread, robust)
        for n, seen in enumerate(relative.tracked.T)
    ]
    return combine(balls, relative.weights, relative.middle, relative.spread, by)
