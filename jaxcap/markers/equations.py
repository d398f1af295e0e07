"""The residuals of all frames with their derivatives, and the markers' variances."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Bool, Float

from ..body.pose import Pose
from .residuals import linearise
from .robust import kernel
from .subject import Subject, shifted


class Rows(NamedTuple):
    """Residuals of all frames in standard deviations, with their derivatives, each times the root of
    its robust weight; not seen is zero."""

    residual: Float[Array, "F M 3"]
    #: by the tangent of the frame's pose, then by the solved centres
    wide: Float[Array, "F M 3 N"]
    #: by the marker's own rest place, which enters no other residual
    own: Float[Array, "F M 3 3"]
    #: robust cost: squared residuals in standard deviations, far ones bounded
    cost: Float[Array, ""]
    #: squared residuals, metres squared
    squared: Float[Array, "F M"]


@eqx.filter_jit
def all_rows(
    subject: Subject,
    poses: Pose,
    places: Float[Array, "F M 3"],
    seen: Bool[Array, "F M"],
    deviations: Float[Array, "M"],
    joints: tuple[int, ...],
    bound: Float[Array, ""],
    shifts: Float[Array, "F M 3"],
) -> Rows:
    """The least-squares problem of all poses and of `s` of `shared` at a point, one frame after the
    other, with markers shifted from their rest places by `shifts`, metres."""
    information = subject.weights / deviations**2

    def of_frame(frame):
        pose, place, there, shift = frame
        rows = linearise(shifted(subject, shift), pose, place, joints)
        squared = jnp.sum(rows.residual**2, 1)
        costs, slopes = kernel(squared * jnp.where(there, information, 0.0), bound)
        roots = jnp.sqrt(jnp.where(there, slopes * information, 0.0))[:, None]
        wide = jnp.concatenate([rows.by_pose, rows.by_centres], 2) * roots[..., None]
        cost = jnp.sum(jnp.where(there, costs, 0.0))
        return Rows(rows.residual * roots, wide, rows.by_offset * roots[..., None], cost, squared)

    rows = jax.lax.map(of_frame, (poses, places, seen, shifts))
    return rows._replace(cost=jnp.sum(rows.cost))


@eqx.filter_jit
def marker_deviations(
    subject: Subject,
    poses: Pose,
    places: Float[Array, "F M 3"],
    seen: Bool[Array, "F M"],
    deviations: Float[Array, "M"],
    least: Float[Array, ""],
    bound: Float[Array, ""],
    shifts: Float[Array, "F M 3"],
    held: Float[Array, "F D D"],
) -> Float[Array, "M"]:
    """The standard deviation of every marker by its own residuals, metres, not below `least`.

    Residuals are shorter than the noise, as poses give way to it: a marker's three numbers a frame
    count less by its leverage on the frame's pose, which `held` has a prior on, and by three for its
    own place. Few numbers lean
    on what all markers show; none is taken for better than a third or worse than ten times that, so
    that no bone hangs on one marker alone.
    """
    information = subject.weights / deviations**2
    used = seen & (subject.weights > 0)

    def of_frame(sums, frame):
        pose, place, there, shift, firm = frame
        rows = linearise(shifted(subject, shift), pose, place)
        squared = jnp.sum(rows.residual**2, 1)
        slopes = jnp.where(there, kernel(squared * information, bound)[1], 0.0)
        flat = (rows.by_pose * jnp.sqrt(slopes * information)[:, None, None]).reshape(3 * len(slopes), -1)
        gram = flat.T @ flat + firm
        scale = 1.0 / jnp.sqrt(jnp.maximum(jnp.diag(gram), 1.0))
        even = gram * scale[:, None] * scale[None, :]
        even = even + (10 * len(even) * jnp.finfo(even.dtype).eps) * jnp.eye(len(even), dtype=even.dtype)
        even = even + jnp.diag(jnp.where(jnp.diag(gram) < 1.0, 1.0, 0.0).astype(even.dtype))
        factor = jnp.linalg.cholesky(even)
        solved = jax.scipy.linalg.solve_triangular(factor, (flat * scale).T, lower=True)
        leverage = jnp.sum((solved**2).reshape(-1, len(slopes), 3), (0, 2))
        left = jnp.maximum(3.0 * slopes - leverage, 0.0)
        return (sums[0] + slopes * squared, sums[1] + left), None

    none = jnp.zeros_like(deviations)
    (squares, left), _ = jax.lax.scan(of_frame, (none, none), (poses, places, used, shifts, held))
    left = jnp.maximum(left - 3.0, 0.0)
    common = jnp.sum(squares) / jnp.maximum(jnp.sum(left), 1.0)
    lean = 10.0
    own = (squares + lean * common) / (left + lean)
    variance = jnp.clip(own, common / 9.0, common * 100.0)
    return jnp.maximum(jnp.sqrt(variance), least)
