"""Energies of neighbouring frames: their residuals and normal equations, window by window."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...body.retraction import retract
from ...energy.stacked import AbstractNeighbourEnergy


class WindowEquations(eqx.Module):
    """Normal equations of the K windows of one energy, of `n` frames each."""

    #: `|r|^2 / 2`, `J^T r` and `J^T J` of the shared unknowns
    total: tuple[Float[Array, ""], Float[Array, "S"], Float[Array, "S S"]]
    blocks: Float[Array, "K n n D D"]
    coupling: Float[Array, "K n D S"]
    gradients: Float[Array, "K n D"]


def window_residuals(
    term: AbstractNeighbourEnergy, body: Body, poses: Pose, times: Float[Array, "F"]
) -> Float[Array, "K R"]:
    """Compute the residual of every window of successive frames, one after the other."""
    return jax.lax.map(lambda window: _residual(term, body, *window), _windows(term, poses, times))


def window_equations(
    term: AbstractNeighbourEnergy,
    body_at: Callable[[Float[Array, "S"]], Body],
    count: int,
    poses: Pose,
    times: Float[Array, "F"],
) -> WindowEquations:
    """Linearise every window by the tangents of its poses and the `count` shared unknowns."""
    body = body_at(jnp.zeros(count, times.dtype))
    number, dofs, dtype = term.frames, body.skeleton.num_dofs, body.vertices.dtype

    def of_window(total, window):
        poses, gaps = window

        def moved(d):
            moved_body = body_at(d[number * dofs :])
            steps = d[: number * dofs].reshape(number, dofs)
            r = _residual(
                term, moved_body, jax.vmap(retract, (None, 0, 0))(moved_body.skeleton, poses, steps), gaps
            )
            return r, r

        rows, r = jax.jacfwd(moved, has_aux=True)(jnp.zeros(number * dofs + count, dtype))
        mine, common = rows[:, : number * dofs].reshape(len(r), number, dofs), rows[:, number * dofs :]
        value, side, matrix = total
        total = value + 0.5 * (r @ r), side + common.T @ r, matrix + common.T @ common
        blocks = jnp.einsum("rai,rbj->abij", mine, mine)
        return total, (blocks, jnp.einsum("rai,rs->ais", mine, common), jnp.einsum("rai,r->ai", mine, r))

    none = jnp.zeros((), dtype), jnp.zeros(count, dtype), jnp.zeros((count, count), dtype)
    total, (blocks, coupling, sides) = jax.lax.scan(of_window, none, _windows(term, poses, times))
    return WindowEquations(total, blocks, coupling, sides)


def _windows(term: AbstractNeighbourEnergy, poses: Pose, times: Float[Array, "F"]):
    number, count = term.frames, times.shape[0] - term.frames + 1
    stacked = jax.tree.map(lambda leaf: jnp.stack([leaf[i : i + count] for i in range(number)], 1), poses)
    gaps = jnp.diff(times)
    return stacked, jnp.stack([gaps[i : i + count] for i in range(number - 1)], 1)


def _residual(term: AbstractNeighbourEnergy, body: Body, poses: Pose, gaps: Float[Array, "W"]):
    each = [jax.tree.map(lambda leaf, i=i: leaf[i], poses) for i in range(term.frames)]
    return term.residual(tuple(pose_body(body, pose) for pose in each), gaps)
