"""Variable projection of a body with linear blend skinning.

Without a Laplacian term, vertices are independent of each other given poses and joints. Each has a rest
position `v` and weights `w` on the simplex, so that

    r(p) = sum_v  min_{w, v}  sum_m | sum_j w_j T_mj(p) v - x_m |^2

is a function of poses and joints `p` alone (Golub and Pereyra 1973). Alternating minimisation converges
slowly, as fixed weights and vertices limit each step of `p`. Steps on `r` account for their change. With
`J_v` the derivatives of a vertex by `p`, and `K_v` those by its own unknowns, without weights at zero, the
Gauss-Newton matrix is (Kaufman 1975)

    H = sum_v J_v^T (I - K_v K_v^+) J_v,    with the gradient  sum_v J_v^T (I - K_v K_v^+) e_v.

A weight can leave its bound in the inner minimum, which is solved anew for every trial step. Bounds therefore
do not block the steps.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ...body.symmetry import bone_length_differences
from ...fit.linear_solvers.block_arrow import BlockArrow, Unknowns
from ...fit.linear_solvers.block_banded import BlockBanded
from ...fit.linear_solvers.cholesky import factorise
from ...fit.solvers.descent import ConstrainedInfo, StepConstraints
from ...fit.solvers.equalities import Equalities
from ...fit.solvers.least_squares_problem import AbstractProblem
from ..skeleton.limbs import BoneState, TreeTopology, bone_derivatives, bone_transforms, move_bones
from ..weights.weights_and_rest import bone_images, expand_weights, optimise_vertices
from .hessian import BoneJacobian, ProjectedHessian, VertexDirections, flat_bones

#: stiffness of a joint rotation by one radian, and of a centre shift by one metre, as shares of r
ROTATION_STIFFNESS, CENTRE_STIFFNESS = 1e-2, 1.0
#: steps of the inner minimum for a trial step
INNER_STEPS = 2
#: ridge for linearly dependent directions of a vertex
RIDGE = 1e-6
#: conjugate gradients: tolerance relative to the right-hand side, and the most steps
TOLERANCE, STEPS = 5e-2, 25


class Blend(eqx.Module):
    """Bones, and the weights and rest positions of the vertices that they blend."""

    bone_state: BoneState
    weights: Float[Array, "V J"]
    rest: Float[Array, "V 3"]


class BlendProblem(AbstractProblem[Blend]):
    """Half the squared residual of blended vertices as a function of bones alone; vertices adapt to each
    step."""

    tree: TreeTopology
    candidates: Int[Array, "V K"]
    targets: Float[Array, "V N"]
    #: left joint, its parent, right joint, its parent
    left_right_bones: Int[Array, "P 4"]
    units: Unknowns

    def value(self, y: Blend) -> Float[Array, ""]:
        return 0.5 * jnp.sum(self.residuals(y) ** 2)

    def residuals(self, y: Blend) -> Float[Array, "V N"]:
        """Compute the residual of each vertex in all frames."""
        return blend_residuals(y, self.tree, self.targets)

    def retract(self, y: Blend, d: Unknowns) -> Blend:
        limbs = move_bones(self.tree, y.bone_state, d)
        return optimise_blend(
            Blend(limbs, y.weights, y.rest), self.tree, self.candidates, self.targets, INNER_STEPS
        )

    def scales(self) -> Unknowns:
        return self.units

    def information(self, y: Blend) -> ConstrainedInfo:
        moves = BoneJacobian(self.tree, y.bone_state, weighted_rest_positions(y), self.units)
        directions = vertex_directions(self.tree, self.candidates, self.targets, y)
        errors = self.residuals(y)
        left = directions.project_out(errors)
        arrow = gauss_newton_matrix(self.tree, y).rescaled(*self.units)
        value = 0.5 * jnp.sum(errors**2)
        none = jax.tree.map(jnp.zeros_like, self.units)
        hessian = ProjectedHessian(
            arrow, none, moves, directions, jnp.asarray(TOLERANCE, errors.dtype), jnp.asarray(STEPS)
        )
        # damp directions with little effect on the residual
        stiff = jax.tree.map(
            lambda u, s: 2.0 * value * s * u**2, self.units, (ROTATION_STIFFNESS, CENTRE_STIFFNESS)
        )
        hessian = hessian.add_diagonal(stiff)
        differences, by_centre = bone_length_differences(y.bone_state.centres, self.left_right_bones)
        rows = by_centre.reshape(len(differences), -1) * self.units[1]
        constraints = StepConstraints(equalities=Equalities(rows, -differences))
        return ConstrainedInfo(value, moves.vjp(left), hessian, constraints=constraints)  # pyright: ignore[reportCallIssue]


def weighted_rest_positions(y: Blend) -> Float[Array, "V B"]:
    """Multiply the homogeneous rest position of each vertex by its weight for each bone."""
    homogeneous = jnp.concatenate([y.rest, jnp.ones_like(y.rest[:, :1])], 1)
    return (y.weights[:, :, None] * homogeneous[:, None]).reshape(len(homogeneous), -1)


def blend_residuals(y: Blend, tree: TreeTopology, targets: Float[Array, "V N"]) -> Float[Array, "V N"]:
    """Compute the residual of each vertex in all frames."""
    return (
        jnp.matmul(
            weighted_rest_positions(y), flat_bones(bone_transforms(tree, y.bone_state)), precision="highest"
        )
        - targets
    )


def optimise_blend(y: Blend, tree: TreeTopology, candidates, targets, steps: int) -> Blend:
    """Optimise the weights and the rest position of each vertex."""
    weights = jnp.take_along_axis(y.weights, candidates, 1)
    found = optimise_vertices(
        weights, y.rest, candidates, bone_transforms(tree, y.bone_state), targets, steps
    )
    return Blend(y.bone_state, expand_weights(found.weights, candidates, y.weights.shape[1]), found.rest)


def gauss_newton_matrix(tree: TreeTopology, y: Blend) -> BlockArrow:
    """Assemble `J^T J` by frames; vertices enter through moments of their weighted rest positions."""
    spread = weighted_rest_positions(y)
    moments = jnp.matmul(spread.T, spread, precision="highest")
    joints = len(tree.parents)
    width, shared = 3 * (joints + len(tree.roots)), 3 * joints
    eye = jnp.eye(width + shared, dtype=spread.dtype)

    def of_frame(limbs):
        frame = BoneState(limbs[0][None], limbs[1][None], y.bone_state.centres)
        moves = jax.vmap(lambda d: bone_derivatives(tree, frame, (d[None, :width], d[width:]))[0])(eye)
        # (B, N) for each axis
        columns = moves.transpose(2, 1, 3, 0).reshape(3, -1, width + shared)
        with jax.default_matmul_precision("highest"):
            return jnp.einsum("abi,abj->ij", columns, moments @ columns)

    grams = jax.lax.map(of_frame, (y.bone_state.rotations, y.bone_state.root_positions))
    frames = BlockBanded(grams[:, None, :width, :width])
    return BlockArrow(frames, grams[:, :width, width:], jnp.sum(grams[:, width:, width:], 0))


def vertex_directions(tree: TreeTopology, candidates, targets, y: Blend) -> VertexDirections:
    """Compute the directions of each vertex with respect to its rest position and to weight exchanges between
    bones."""
    bones = bone_transforms(tree, y.bone_state)
    weights = jnp.take_along_axis(y.weights, candidates, 1)
    differences = bone_images(bones, y.rest, candidates) - targets[:, None]
    first = jnp.argmax(weights, 1)
    base = jnp.take_along_axis(differences, first[:, None, None], 1)
    differences = jnp.where((weights > 0)[:, :, None], differences - base, 0.0)
    turns = jnp.swapaxes(bones[..., :3], 0, 1).transpose(0, 3, 1, 2).reshape(y.weights.shape[1], -1)
    by_place = jnp.matmul(y.weights, turns, precision="highest").reshape(len(weights), 3, -1)
    rows = jnp.concatenate([by_place, differences], 1)
    rows = rows / (jnp.linalg.norm(rows, axis=2, keepdims=True) + jnp.finfo(rows.dtype).eps)
    gram = jnp.einsum("vin,vjn->vij", rows, rows, precision="highest")
    eye = jnp.eye(gram.shape[1], dtype=gram.dtype)
    inverse = jax.lax.map(lambda g: factorise(g, RIDGE).solve(eye), gram)
    return VertexDirections(rows, inverse)
