"""Residuals of a posed body with their Jacobian by the pose, and by parameters of the body itself."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.interpreters.partial_eval import dce_jaxpr
from jaxtyping import Array, Float, Int

from ..batched_map import map_batches
from ..body.body import Body, Posed, pose_body
from ..body.geometric_jacobian import (
    concatenate_jacobians,
    descendant_matrix,
    joint_jacobian,
    pose_jacobian,
    select_parameters,
)
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..body.retraction import retract
from ..energy.data.bones import AbstractBoneEnergy
from ..energy.data.vertices import AbstractVertexEnergy
from ..energy.energy import AbstractEnergy, Weighted, safe_sqrt, terms_of, unweighted
from ..geometry import rotation

#: points whose rows are summed together: as many as fit in a core's cache
BATCH = 64


class BodyTangent(eqx.Module):
    """The derivative of a body at rest by S parameters shared by all frames."""

    centres: Float[Array, "J 3 S"]
    #: rotations of the joints' orientations on the right, radians per unit; None if no parameter rotates them
    rotations: Float[Array, "J 3 S"] | None
    vertices: Float[Array, "V 3 S"]
    #: derivatives of all other arrays of the body, such as skinning weights, with S as their last axis; None
    #: for constant ones
    other_arrays: Body


def linearise(
    energy: AbstractEnergy, body: Body, pose: Pose
) -> tuple[Float[Array, "R"], Float[Array, "R D"]]:
    """Compute residual and Jacobian of an energy at a pose, by tangents of `retract`, rows in the order of
    `energy.residual`.

    Terms over vertices use the skin's own Jacobian (Kineben, eqs. 8 to 13), which costs one sum down the tree
    for each joint. All other terms use forward automatic differentiation, which pushes each of the D tangents
    through the whole skin.
    """
    return frame_jacobian(energy, body, pose, None, None)


def frame_jacobian(
    energy: AbstractEnergy,
    body: Body,
    pose: Pose,
    body_at: Callable[[Float[Array, "S"]], Body] | None,
    tangent: BodyTangent | None,
) -> tuple[Float[Array, "R"], Float[Array, "R N"]]:
    """Compute residual and Jacobian of a frame by `[d, s]`, the tangent of its pose and the S parameters of
    the body.

    **Arguments:** `body_at(s)` makes the body of shared parameters, `body_at(0) = body`; `tangent` is its
    derivative at zero.
    """
    return posed_jacobian(energy, pose_body(body, pose), body_at, tangent)


def posed_jacobian(
    energy: AbstractEnergy,
    posed: Posed,
    body_at: Callable[[Float[Array, "S"]], Body] | None,
    tangent: BodyTangent | None,
) -> tuple[Float[Array, "R"], Float[Array, "R N"]]:
    """Compute the `frame_jacobian` of a body that is posed already."""
    body, pose, terms = posed.body, posed.pose, terms_of(energy)
    closed = (AbstractVertexEnergy, AbstractBoneEnergy) if tangent is None else AbstractVertexEnergy
    others = tuple(term for term in terms if not isinstance(unweighted(term), closed))
    dofs = body.skeleton.num_dofs
    count = 0 if tangent is None else tangent.centres.shape[2]

    def moved(d):
        moved_body = body if body_at is None else body_at(d[dofs:])
        placed = pose_body(moved_body, retract(moved_body.skeleton, pose, d[:dofs]))
        residuals = tuple(term.residual(placed) for term in others)
        return residuals, residuals

    # all in one pass, so that common parts of the terms are differentiated once
    zero = jnp.zeros(dofs + count, body.vertices.dtype)
    jacobians, residuals = jax.jacfwd(moved, has_aux=True)(zero) if others else ((), ())
    differentiated = iter(zip(residuals, jacobians, strict=True))
    rows = [
        (term.residual(posed), _term_jacobian(term, posed, tangent))
        if isinstance(unweighted(term), closed)
        else next(differentiated)
        for term in terms
    ]
    return jnp.concatenate([r for r, _ in rows]), jnp.concatenate([j for _, j in rows])


def body_tangent(
    body_at: Callable[[Float[Array, "S"]], Body], body: Body, num_parameters: int
) -> BodyTangent:
    """Differentiate the body by `num_parameters` shared parameters at zero; `body` is the one at zero."""
    zero = jnp.zeros(num_parameters, body.vertices.dtype)
    changed = _dependent_arrays(body_at, zero)
    by_number = jax.jacfwd(lambda s: eqx.filter(body_at(s), changed))(zero)
    centres, turns, vertices = _closed_form_arrays(by_number)
    if centres is None:
        centres = jnp.zeros((*body.skeleton.centres.shape, num_parameters), zero.dtype)
    if vertices is None:
        vertices = jnp.zeros((*body.vertices.shape, num_parameters), zero.dtype)
    if turns is not None:
        # the derivative of q exp(w) is q (0, w) / 2
        back = jax.vmap(
            lambda q, rates: jax.vmap(lambda rate: rotation.multiply(rotation.conjugate(q), rate), 1, 1)(
                rates
            )
        )(body.skeleton.orientations, turns)
        turns = 2.0 * back[:, 1:]
    others = eqx.tree_at(_closed_form_arrays, by_number, replace=(None, None, None), is_leaf=_is_none)
    return BodyTangent(centres, turns, vertices, others)


def _closed_form_arrays(body: Body):
    return body.skeleton.centres, body.skeleton.orientations, body.vertices


def _dependent_arrays(body_at: Callable[[Float[Array, "S"]], Body], zero: Float[Array, "S"]) -> Body:
    """Find the arrays of a body that depend on the shared parameters: a tree of booleans."""

    def arrays(s):
        return [leaf for leaf in jax.tree.leaves(body_at(s)) if eqx.is_inexact_array(leaf)]

    program = jax.make_jaxpr(arrays)(zero).jaxpr
    count = len(program.outvars)
    depends = iter([dce_jaxpr(program, [k == each for k in range(count)])[1][0] for each in range(count)])
    body = eqx.filter_eval_shape(body_at, zero)
    return jax.tree.map(lambda leaf: _is_inexact(leaf) and next(depends), body)


def _is_inexact(leaf: object) -> bool:
    return isinstance(leaf, jax.ShapeDtypeStruct) and jnp.issubdtype(leaf.dtype, jnp.inexact)


def vertex_maps(body: Body, pose: Pose) -> tuple[Float[Array, "V 3 3"], Float[Array, "V 3"]]:
    """Compute `A (V, 3, 3)` and `x (V, 3)`: every posed vertex is `x + A e` if its rest position is moved by
    `e` (Adaptation, 4.1.4: a posed vertex depends linearly on its rest position).
    """
    transforms = forward_kinematics(body.skeleton, pose)

    def deform(shift):
        return body.skin.deform(body.vertices + shift, body.skeleton, pose, transforms)

    still = deform(jnp.zeros(3, body.vertices.dtype))
    columns = [deform(axis) - still for axis in jnp.eye(3, dtype=body.vertices.dtype)]
    return jnp.stack(columns, -1), still


def point_jacobian(
    posed: Posed,
    vertices: Int[Array, "C K"],
    directions: Float[Array, "C K R 3"],
    tangent: BodyTangent | None = None,
) -> Float[Array, "C R N"]:
    """Compute rows `sum_k n_k . dx_k/d[d, s]` of points between K vertices each, by the pose and by the
    shared parameters.

    If there are more rows than coordinates of the body's vertices, each vertex is differentiated once, along the three axes.
    """
    if directions.size // 3 <= posed.vertices.size:
        every = vertices.reshape(-1)
        rows = _skin_jacobian(posed, every, directions.reshape(-1, *directions.shape[2:]), tangent)
        return jnp.sum(rows.reshape(*vertices.shape, *rows.shape[1:]), 1)
    along_axes = vertex_jacobian(posed, tangent)

    def of_place(place):
        corners, along = place
        moved = along_axes[corners].reshape(-1, along_axes.shape[2])
        # summed explicitly, because batched products per point are slow on a CPU
        along = jnp.swapaxes(along, 1, 2).reshape(len(moved), -1)
        return sum(along[i, :, None] * moved[i] for i in range(len(moved)))

    return map_batches(of_place, (vertices, directions), BATCH)


def vertex_jacobian(posed: Posed, tangent: BodyTangent | None = None) -> Float[Array, "V 3 N"]:
    """Differentiate all posed vertices by the pose and by the shared parameters."""
    count, dtype = len(posed.vertices), posed.vertices.dtype
    axes = jnp.broadcast_to(jnp.eye(3, dtype=dtype), (count, 3, 3))
    return _skin_jacobian(posed, jnp.arange(count), axes, tangent)


def _skin_jacobian(
    posed: Posed,
    vertices: Int[Array, "C"],
    directions: Float[Array, "C R 3"],
    tangent: BodyTangent | None,
) -> Float[Array, "C R N"]:
    """Compute the rows of single vertices along their directions."""
    body, pose = posed.body, posed.pose
    skeleton = body.skeleton
    rates = pose_jacobian(skeleton, pose, posed.transforms)
    if tangent is not None:
        known = range(3) if tangent.rotations is None else range(6)
        slots = np.array([6 * joint + number for joint in range(skeleton.num_joints) for number in known])
        rates = concatenate_jacobians(
            rates, select_parameters(joint_jacobian(skeleton, pose, posed.transforms), slots)
        )
    skin = body.skin.take(vertices)
    rows = skin.jacobian(body.vertices[vertices], directions, skeleton, pose, posed.transforms, rates)
    if tangent is None:
        return rows
    dofs = skeleton.num_dofs
    by_joint = (
        tangent.centres
        if tangent.rotations is None
        else jnp.concatenate([tangent.centres, tangent.rotations], 1)
    )
    maps, _ = vertex_maps(body, pose)
    pulled = jnp.einsum("cra,cab->crb", directions, maps[vertices])
    carried = jnp.einsum("crb,cbs->crs", pulled, tangent.vertices[vertices])
    shared = carried + rows[:, :, dofs:] @ by_joint.reshape(-1, by_joint.shape[2])
    if jax.tree.leaves(tangent.other_arrays):
        moved = _other_arrays_jacobian(body, pose, tangent.other_arrays)[vertices]
        shared = shared + jnp.einsum("cra,cas->crs", directions, moved)
    return jnp.concatenate([rows[:, :, :dofs], shared], 2)


def _other_arrays_jacobian(body: Body, pose: Pose, others: Body) -> Float[Array, "V 3 S"]:
    """Differentiate posed vertices by the shared parameters through arrays of the body without a closed form
    here.
    """
    truths = jax.tree.map(lambda leaf: leaf is not None, others, is_leaf=_is_none)
    changed, rest = eqx.partition(body, truths)

    def moved(direction):
        return jax.jvp(
            lambda arrays: pose_body(eqx.combine(arrays, rest), pose).vertices, (changed,), (direction,)
        )[1]

    return jax.vmap(moved, -1, -1)(others)


def _is_none(node: object) -> bool:
    return node is None


def weighted_derivatives(
    term: AbstractEnergy, posed: Posed
) -> tuple[Int[Array, "C K"], Float[Array, "C K R 3"]]:
    """Differentiate a weighted term over vertices by their positions, as
    `AbstractVertexEnergy.vertex_jacobian` does."""
    if isinstance(term, Weighted):
        vertices, directions = weighted_derivatives(term.energy, posed)
        return vertices, safe_sqrt(term.weight) * directions
    assert isinstance(term, AbstractVertexEnergy)
    vertices, directions = term.vertex_jacobian(posed)
    return (vertices[:, None], directions[:, None]) if vertices.ndim == 1 else (vertices, directions)


def _term_jacobian(term: AbstractEnergy, posed: Posed, tangent: BodyTangent | None) -> Float[Array, "R N"]:
    if isinstance(unweighted(term), AbstractBoneEnergy):
        return _bone_term_jacobian(term, posed)
    rows = point_jacobian(posed, *weighted_derivatives(term, posed), tangent)
    return rows.reshape(-1, rows.shape[2])


def _bone_term_jacobian(term: AbstractEnergy, posed: Posed) -> Float[Array, "R D"]:
    """Differentiate a weighted term over bones by the pose."""
    bones, rows = weighted_bone_derivatives(term, posed)
    velocities = bone_velocities(posed)
    count, dofs = len(rows) * rows.shape[2], velocities.shape[2]
    if bones is None:
        return jnp.swapaxes(rows, 1, 2).reshape(count, -1) @ velocities.reshape(-1, dofs)
    return jnp.einsum("ckrn,cknd->crd", rows, velocities[bones]).reshape(count, dofs)


def weighted_bone_derivatives(
    term: AbstractEnergy, posed: Posed
) -> tuple[Int[Array, "C K"] | None, Float[Array, "C K R 6"]]:
    """Differentiate a weighted term over bones by their velocities, as `AbstractBoneEnergy.bone_jacobian`
    does."""
    if isinstance(term, Weighted):
        bones, rows = weighted_bone_derivatives(term.energy, posed)
        return bones, safe_sqrt(term.weight) * rows
    assert isinstance(term, AbstractBoneEnergy)
    return term.bone_jacobian(posed)


def bone_velocities(posed: Posed) -> Float[Array, "J 6 D"]:
    """Compute the velocity of each bone by each parameter of the pose: the angular, then the linear one."""
    skeleton = posed.body.skeleton
    rates = pose_jacobian(skeleton, posed.pose, posed.transforms)
    fields = jnp.concatenate([rates.angular, rates.linear], 1)
    return descendant_matrix(skeleton, rates)[:, None] * fields.T
