"""Linear and rigid weights of single vertices: exact, as posed vertices are linear in them."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...fit.solvers.simplex_least_squares import largest_weights, simplex_least_squares


class LinearWeightSolver(eqx.Module):
    """Bone transforms, frames last, to solve for linear weights by least squares."""

    rotations: Float[Array, "J 9 F"]
    translations: Float[Array, "J 3 F"]
    #: the most bones per vertex
    influences: int | None = eqx.field(static=True, default=None)
    num_candidates: int = eqx.field(static=True, default=1)

    def solve(
        self,
        rows: Float[Array, "C J"],
        neighbour_rows: list[Float[Array, "C J"]],
        rest: Float[Array, "C 3 N"],
        target_offsets: Float[Array, "C 3 F"],
        slide_length: Float[Array, ""],
        relaxation: Float[Array, ""],
        num_candidates: Int[Array, ""],
    ) -> tuple[Float[Array, "C J"], Float[Array, "C 3 F"], Float[Array, "C"]]:
        """Solve for the best weights of each vertex; the interface of `SwingTwistWeightSolver.solve`,
        without slides."""
        del neighbour_rows, slide_length, num_candidates
        images = self._images(rest)
        # differences from the current position keep precision for near bones next to far ones
        differences = images - jnp.einsum("cj,cjaf->caf", rows, images)[:, None]
        flat = differences.reshape(*rows.shape, -1)
        gram = jnp.einsum("cjf,ckf->cjk", flat, flat)
        linear = jnp.einsum("cjf,cf->cj", flat, relaxation * target_offsets.reshape(len(rows), -1))
        weights = simplex_least_squares(gram, linear, rows)
        if self.influences is not None:
            allowed = largest_weights(weights, self.influences)
            kept = jnp.where(allowed, weights, 0.0)
            kept = kept / jnp.sum(kept, 1, keepdims=True)
            weights = simplex_least_squares(gram, linear, kept, allowed)
        shift = jnp.einsum("cj,cjaf->caf", weights, differences)
        return (
            weights,
            shift,
            jnp.sum(target_offsets**2, (1, 2)) - jnp.sum((target_offsets - shift) ** 2, (1, 2)),
        )

    def _images(self, rest: Float[Array, "C 3 N"]) -> Float[Array, "C J 3 F"]:
        axes = [
            sum(self.rotations[:, 3 * a + b] * rest[:, b, None] for b in range(3)) + self.translations[:, a]
            for a in range(3)
        ]
        return jnp.stack(axes, 2)


class RigidWeightSolver(eqx.Module):
    """Bone transforms, frames last, to find the bone of each vertex of a rigid skin."""

    linear: LinearWeightSolver
    num_candidates: int = eqx.field(static=True, default=1)

    def solve(
        self,
        rows: Int[Array, "C"],
        neighbour_rows: list[Int[Array, "C"]],
        rest: Float[Array, "C 3 N"],
        target_offsets: Float[Array, "C 3 F"],
        slide_length: Float[Array, ""],
        relaxation: Float[Array, ""],
        num_candidates: Int[Array, ""],
    ) -> tuple[Int[Array, "C"], Float[Array, "C 3 F"], Float[Array, "C"]]:
        """Choose the best bone of each vertex; the interface of `SwingTwistWeightSolver.solve`, without
        slides."""
        del neighbour_rows, slide_length, relaxation, num_candidates
        images = self.linear._images(rest)
        differences = images - jnp.take_along_axis(images, rows[:, None, None, None], 1)
        left = jnp.sum((target_offsets[:, None] - differences) ** 2, (2, 3))
        best = jnp.argmin(left, 1)
        shift = jnp.take_along_axis(differences, best[:, None, None, None], 1)[:, 0]
        gain = jnp.sum(target_offsets**2, (1, 2)) - jnp.take_along_axis(left, best[:, None], 1)[:, 0]
        return best.astype(rows.dtype), shift, gain


@eqx.filter_jit
def make_linear_weight_solver(
    skeleton: Skeleton, poses: Pose, influences: int | None = None
) -> LinearWeightSolver:
    """Compute the bone transforms in stacked poses."""
    bones = jax.vmap(lambda pose: forward_kinematics(skeleton, pose))(poses)
    frames, joints = bones.translations.shape[:2]
    last = lambda array: jnp.moveaxis(array.reshape(frames, joints, -1), 0, -1)  # noqa: E731
    return LinearWeightSolver(last(bones.rotations), last(bones.translations), influences)
