"""The normal equations of all frames' poses with what they share, and the markers' variances."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Bool, Float

from ..body.pose import Pose
from ..fit.arrow import Arrow
from .residuals import linearise
from .robust import kernel
from .subject import Subject


class Equations(NamedTuple):
    """Block-arrow normal equations at some poses and subject, without a prior."""

    arrow: Arrow
    #: robust cost: squared residuals in standard deviations, far ones bounded
    cost: Float[Array, ""]
    #: squared residuals, metres squared
    squared: Float[Array, "F M"]


class _Sums(NamedTuple):
    centres: Float[Array, "C C"]
    across: Float[Array, "C T"]
    offsets: Float[Array, "M 3 3"]
    side: Float[Array, "S"]
    cost: Float[Array, ""]


@eqx.filter_jit
def normal_equations(
    subject: Subject,
    poses: Pose,
    places: Float[Array, "F M 3"],
    seen: Bool[Array, "F M"],
    deviations: Float[Array, "M"],
    joints: tuple[int, ...],
    bound: Float[Array, ""],
) -> Equations:
    """The equations by the tangents of all poses and by `s` of `shared`, in standard deviations.

    A marker's rest place enters its own residual only, so of the shared block the markers' part is
    made of 3 x 3 blocks; no product runs over all of it.
    """
    markers, centres = subject.num_markers, 3 * len(joints)
    dofs, dtype = subject.skeleton.num_dofs, places.dtype
    information = subject.weights / deviations**2

    def of_frame(sums: _Sums, frame):
        pose, place, there = frame
        rows = linearise(subject, pose, place, joints)
        squared = jnp.sum(rows.residual**2, 1)
        costs, slopes = kernel(squared * jnp.where(there, information, 0.0), bound)
        weights = jnp.where(there, slopes * information, 0.0)
        wide = jnp.concatenate([rows.by_pose, rows.by_centres], 2)
        weighted = wide * weights[:, None, None]
        flat = weighted.reshape(3 * markers, -1)
        gram = flat.T @ wide.reshape(3 * markers, -1)
        by_offset = jnp.einsum("man,mab->nmb", weighted, rows.by_offset).reshape(dofs + centres, -1)
        own = jnp.einsum("mab,mac->mbc", rows.by_offset * weights[:, None, None], rows.by_offset)
        side = -(flat.T @ rows.residual.ravel())
        own_side = -jnp.einsum("mab,m,ma->mb", rows.by_offset, weights, rows.residual)
        new = _Sums(
            gram[dofs:, dofs:],
            by_offset[dofs:],
            own,
            jnp.concatenate([side[dofs:], own_side.ravel()]),
            jnp.sum(jnp.where(there, costs, 0.0)),
        )
        coupling = jnp.concatenate([gram[:dofs, dofs:], by_offset[:dofs]], 1)
        sums = jax.tree.map(jnp.add, sums, new)
        return sums, (gram[:dofs, :dofs], coupling, side[:dofs], squared)

    sizes = (centres, centres), (centres, 3 * markers), (markers, 3, 3), (centres + 3 * markers,), ()
    start = _Sums(*(jnp.zeros(size, dtype) for size in sizes))
    sums, (frames, coupling, sides, squared) = jax.lax.scan(of_frame, start, (poses, places, seen))
    diagonal = jnp.zeros((markers, 3, markers, 3), dtype)
    diagonal = diagonal.at[np.arange(markers), :, np.arange(markers)].set(sums.offsets)
    offsets = diagonal.reshape(3 * markers, 3 * markers)
    shared = jnp.block([[sums.centres, sums.across], [sums.across.T, offsets]])
    return Equations(Arrow(frames, coupling, shared, sides, sums.side), sums.cost, squared)


@eqx.filter_jit
def marker_deviations(
    subject: Subject,
    poses: Pose,
    places: Float[Array, "F M 3"],
    seen: Bool[Array, "F M"],
    deviations: Float[Array, "M"],
    least: Float[Array, ""],
    bound: Float[Array, ""],
) -> Float[Array, "M"]:
    """The standard deviation of every marker by its own residuals, metres, not below `least`.

    Residuals are shorter than the noise, as poses give way to it: a marker's three numbers a frame
    count less by its leverage on the frame's pose, and by three for its own place. Few numbers lean
    on what all markers show; none is taken for better than a third or worse than ten times that, so
    that no bone hangs on one marker alone.
    """
    information = subject.weights / deviations**2
    used = seen & (subject.weights > 0)

    def of_frame(sums, frame):
        pose, place, there = frame
        rows = linearise(subject, pose, place)
        squared = jnp.sum(rows.residual**2, 1)
        slopes = jnp.where(there, kernel(squared * information, bound)[1], 0.0)
        flat = (rows.by_pose * jnp.sqrt(slopes * information)[:, None, None]).reshape(3 * len(slopes), -1)
        gram = flat.T @ flat
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
    (squares, left), _ = jax.lax.scan(of_frame, (none, none), (poses, places, used))
    left = jnp.maximum(left - 3.0, 0.0)
    common = jnp.sum(squares) / jnp.maximum(jnp.sum(left), 1.0)
    lean = 10.0
    own = (squares + lean * common) / (left + lean)
    variance = jnp.clip(own, common / 9.0, common * 100.0)
    return jnp.maximum(jnp.sqrt(variance), least)
