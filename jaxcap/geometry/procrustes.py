"""Orthogonal Procrustes: the rigid motion that best aligns one set of points with another.

The best rigid motions of a set of points in F frames, and their error, depend only on its sums of first and
second order (Schönemann 1966; Kabsch 1976). The sums of a union are the sums of those of its parts, so the
error of a union costs no more than that of a point.

Plain NumPy in the arrays' own precision; give float64 where errors are small compared with distances.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Floats = np.ndarray


class Moments(NamedTuple):
    """Sums over sets of weighted source points `p` and their target positions `x`, in every frame.

    Any leading axes, here `S` sets; all moments add, field by field.
    """

    #: sum of w
    mass: Float[Floats, "*S"]
    #: sum of w p
    source: Float[Floats, "*S 3"]
    #: sum of w x
    target: Float[Floats, "*S F 3"]
    #: sum of w |p|^2
    source_square: Float[Floats, "*S"]
    #: sum of w |x|^2, over all frames
    target_square: Float[Floats, "*S"]
    #: sum of w x p^T
    cross: Float[Floats, "*S F 3 3"]

    def at(self, sets) -> "Moments":
        """Select the moments of some of the sets."""
        return Moments(*(field[sets] for field in self))

    def plus(self, other: "Moments") -> "Moments":
        """Add moments field by field, for unions of sets."""
        return Moments(*(a + b for a, b in zip(self, other, strict=True)))


def group_moments(
    groups,
    source: Float[Floats, "V 3"],
    target: Float[Floats, "V F 3"],
) -> Moments:
    """Compute moments of sets of points; `groups (S, V)` is a dense or scipy.sparse matrix of weights."""
    count, frames = target.shape[:2]
    flat = target.reshape(count, 3 * frames)
    columns = [(groups @ (flat * source[:, b : b + 1])).reshape(-1, frames, 3) for b in range(3)]
    return Moments(
        mass=np.asarray(groups @ np.ones(count)),
        source=groups @ source,
        target=(groups @ flat).reshape(-1, frames, 3),
        source_square=np.asarray(groups @ np.sum(source * source, 1)),
        target_square=np.asarray(groups @ np.einsum("vi,vi->v", flat, flat)),
        cross=np.stack(columns, -1),
    )


def nearest_rotation(matrix: Float[Floats, "*N 3 3"]) -> Float[Floats, "*N 3 3"]:
    """Find the rotation `R` with the greatest `tr(R^T M)`; proper also where M is a reflection or singular."""
    u, _, vt = np.linalg.svd(matrix)
    sign = np.where(np.linalg.det(u) * np.linalg.det(vt) < 0, -1.0, 1.0)
    u[..., :, 2] *= sign[..., None]
    return u @ vt


def rigid_motions(moments: Moments) -> tuple[Float[Floats, "*S F 3 3"], Float[Floats, "*S F 3"]]:
    """Compute the best rotations and translations, `x = R p + t`, of every set in every frame."""
    middle, places = _means(moments)
    rotations = nearest_rotation(_centred(moments))
    return rotations, places - np.einsum("...fab,...b->...fa", rotations, middle)


def rigid_errors(moments: Moments) -> Float[Floats, "*S"]:
    """Compute the residual of the best rigid motions, `sum of w |R p + t - x|^2` over points and frames."""
    frames = moments.target.shape[-2]
    middle, places = _means(moments)
    cross = _centred(moments)
    values = np.linalg.svd(cross, compute_uv=False)
    # the greatest tr(R^T M) over proper rotations (Umeyama 1991)
    mirrored = np.where(np.linalg.det(cross) < 0, -1.0, 1.0)
    agreement = values[..., 0] + values[..., 1] + mirrored * values[..., 2]
    spread = moments.target_square - moments.mass * np.sum(places * places, (-2, -1))
    own = moments.source_square - moments.mass * np.sum(middle * middle, -1)
    return np.asarray(np.maximum(spread + frames * own - 2 * agreement.sum(-1), 0.0))


def rigid_fit(
    source: Float[Floats, "V 3"], target: Float[Floats, "V 3"], weights: Float[Floats, "V"] | None = None
) -> tuple[Float[Floats, "3 3"], Float[Floats, "3"]]:
    """Find the rotation and translation with the least `sum of w |R p + t - x|^2` (Kabsch 1976).

    Collinear points, or a single one, leave the rotation undetermined; one of the best is returned.
    """
    weights = np.ones(len(source)) if weights is None else weights
    rotations, translations = rigid_motions(group_moments(weights[None], source, target[:, None]))
    return rotations[0, 0], translations[0, 0]


def _means(moments: Moments) -> tuple[np.ndarray, np.ndarray]:
    mass = np.where(moments.mass > 0, moments.mass, 1.0)
    return moments.source / mass[..., None], moments.target / mass[..., None, None]


def _centred(moments: Moments) -> np.ndarray:
    _, places = _means(moments)
    return moments.cross - places[..., :, :, None] * moments.source[..., None, None, :]
