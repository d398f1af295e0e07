"""The closed-form centre of concentric spheres (Gamage and Lasenby 2002), without its bias (Halvorsen 2003)."""

import numpy as np
from jaxtyping import Bool, Float

from .common import LEAST, ROUNDS, Centre, prior_weight, robust_weights
from .precision import independent_share
from .relative import Relative


def gamage_centre(relative: Relative, robust: bool = True, unbiased: bool = True) -> Centre:
    """The common centre of the spheres on which the child's markers move in the parent's frame.

    The least sum over markers of the variance of `|v - c|^2` (Gamage and Lasenby 2002, eq. 5) is
    linear in `c`, but biased towards the markers: noise of variance `s^2` adds `2 s^2` to the
    matrix of each marker and `2 s^2` times its mean to the right side. Both are taken off again, with
    `s` from the residual, until it settles (Halvorsen 2003). Needs the parent's frame only.
    """
    c, covariance = concentric(
        relative.tracks,
        relative.tracked,
        relative.weights,
        relative.middle,
        relative.spread,
        robust,
        unbiased,
    )
    in_child = None
    if relative.rotations is not None and relative.translations is not None:
        there = np.einsum("fba,fb->fa", relative.rotations, c - relative.translations)
        in_child = np.median(there, axis=0)
    return Centre(c, in_child, covariance)


def concentric(
    tracks: Float[np.ndarray, "F N 3"],
    tracked: Bool[np.ndarray, "F N"],
    marker_weights: Float[np.ndarray, "N"],
    middle: Float[np.ndarray, "3"],
    spread: float,
    robust: bool = True,
    unbiased: bool = True,
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """The common centre and its covariance, from trajectories of N markers."""
    v = np.where(tracked[..., None], tracks - middle, 0.0)
    squares = np.sum(v * v, -1)
    weights = tracked * marker_weights
    noise, c, held = 0.0, np.zeros(3), 0.0
    off, share, matrix = np.zeros(tracked.shape), 1.0, np.eye(3)
    for turn in range(3 * ROUNDS):
        mass = np.maximum(weights.sum(0), 1e-300)
        mean = np.einsum("fn,fna->na", weights, v) / mass[:, None]
        centred = np.where(tracked[..., None], v - mean, 0.0)
        matrix = np.einsum("fn,fna,fnb->ab", weights, centred, centred)
        side = 0.5 * np.einsum("fn,fna,fn->a", weights, centred, squares)
        if unbiased:
            # half of Halvorsen's terms, as the whole equation is halved
            matrix = matrix - noise * weights.sum() * np.eye(3)
            side = side - noise * np.einsum("fn,na->a", weights, mean)
        least = np.linalg.eigvalsh(matrix)[0]
        # with hardly any turn all the spread may be noise: the prior then decides
        lift = max(0.0, -least) + LEAST * np.trace(matrix)
        old = c
        c = np.linalg.solve(matrix + (held + lift) * np.eye(3), side)
        distances = np.linalg.norm(v - c, axis=-1)
        radius = np.einsum("fn,fn->n", weights, distances) / mass
        off = np.where(tracked, distances - radius, 0.0)
        if robust:
            away = np.abs(off)
            scale = np.median(away[tracked])
            weights = (
                tracked
                * marker_weights
                * robust_weights(np.where(tracked, away, scale).ravel()).reshape(off.shape)
            )
        noise = float((weights * off**2).sum() / weights.sum())
        share = independent_share(off)
        information = float(np.trace(matrix)) / 3
        # per unit of the radius, as the rows are radii times distances
        held = prior_weight(abs(information), noise * float((radius**2).mean()), share, spread)
        if turn > 3 and np.abs(c - old).max() < 1e-10:
            break
    # a row of the equation is radius times the deviation of the distance
    mean_square = float((weights.sum(0) @ radius**2) / weights.sum())
    covariance = noise * mean_square / share * np.linalg.inv(matrix + (held + lift) * np.eye(3))
    return middle + c, covariance
