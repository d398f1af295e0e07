"""Fitting of a body to registered meshes: the correspondence of every vertex is known."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ..arguments import checked
from ..body.body import Body, pose_body
from ..body.pose import Motion, Pose
from ..body.retraction import project
from ..body.skeleton import Skeleton
from ..energy.check_energies import UserTerms, check_finite_residuals, sum_user_terms
from ..energy.data.landmarks import VertexLandmarks
from ..energy.energy import AbstractEnergy, Sum, terms_of
from ..errors import InputError
from ..geometry import rotation
from ..geometry.procrustes import group_moments, nearest_rotation
from ..observe.meshes import MeshSequence
from .solve import solve
from .solvers.levenberg_marquardt import LevenbergMarquardt

#: weight of the parent's rotation for a limb whose own vertices do not determine its rotation, as a share of
#: the body's moment
PARENT_WEIGHT = 1e-6
#: one over the mean squared distance of vertices at which the solver's damping has equal weight, 1/m²
DATA_WEIGHT = 1e6


class MeshFit(eqx.Module):
    """The result of `fit_meshes` over F meshes."""

    motion: Motion
    #: root mean square distance of the vertices from their targets, metres; NaN if no target is known
    rmse: Float[Array, "F"]
    num_steps: Int[Array, "F"]
    #: true if a mesh was fitted: it has finite vertices, and the solver converged to a finite pose
    converged: Bool[Array, "F"]


@checked
def fit_meshes(
    body: Body,
    sequence: MeshSequence,
    *,
    start: Pose | Motion | None = None,
    vertices: Int[Array | np.ndarray, "C"] | None = None,
    max_steps: int = 40,
    terms: UserTerms = (),
) -> MeshFit:
    """Fit the poses of a body to registered meshes, by Levenberg-Marquardt from `procrustes_poses`.

    Meshes are fitted independently, compiled once.

    **Arguments:** `start` poses stacked over the meshes, in place of Procrustes' own; `vertices` indices of
    those that count, all where not given. A vertex that is not finite in a mesh does not count there. `terms`
    are further energies of the posed body, such as a floor; a unit of them has the weight of a root mean
    square distance of a millimetre. `converged` marks the meshes that could be fitted; the others do not
    affect them.

    With `start`, `jax.grad` differentiates the poses, by vertices, body and terms.

    **Raises:** `InputError` where the meshes have other vertices than the body, no mesh is given, or there are more or fewer
    poses than meshes.
    """
    check_mesh_sequence(body, sequence)
    count = body.vertices.shape[0]
    positions = sequence.vertices.astype(body.vertices.dtype)
    poses = procrustes_poses(body, sequence) if start is None else poses_of_meshes(start, len(sequence))
    chosen = jnp.arange(count) if vertices is None else jnp.asarray(vertices)
    own = sum_user_terms("fit_meshes", terms, body)
    if own is not None:
        check_finite_residuals("fit_meshes", own, body, Motion(poses)[0])
    poses, rmse, steps, converged = _fit_all(body, poses, positions, chosen, own, max_steps)
    return MeshFit(Motion(poses, sequence.rate), rmse, steps, converged)


def poses_of_meshes(start: Pose | Motion, count: int, name: str = "start") -> Pose:
    """Return the poses to start from, the argument `name`, one for each of `count` meshes. Raises `ValueError` where there are
    more or fewer.
    """
    poses = start.poses if isinstance(start, Motion) else start
    if poses.scale.shape != (count,):
        given = "a single pose" if poses.scale.ndim == 0 else f"{len(poses.scale)} poses"
        raise ValueError(
            f"`{name}` is {given}; expected one for each of {count} meshes, stacked, such as stack_poses([...])."
        )
    return poses


def check_mesh_sequence(body: Body, sequence: MeshSequence) -> None:
    """Check that there are meshes, with the vertices of a body. Raises `InputError`."""
    count = body.vertices.shape[0]
    if sequence.vertices.shape[1] != count:
        raise InputError(
            f"The meshes have {sequence.vertices.shape[1]} vertices; expected the {count} vertices of the "
            "body, in their order; use `track` for meshes with other vertices."
        )
    if len(sequence) == 0:
        raise InputError("There is no mesh to fit; give a sequence of at least one mesh.")


def procrustes_poses(body: Body, sequence: MeshSequence) -> Pose:
    """Estimate poses stacked over meshes, limb by limb, by orthogonal Procrustes (Adaptation, section 3.2.1).

    From the root on, each bone takes the rotation that best aligns its own vertices, weighted by its
    influence on them, with their targets, as far as its joint's type allows. Vertices of fixed joints count for
    the bone that these move with. In NumPy and float64.

    A limb whose vertices are collinear, or that has none, follows its parent.
    """
    skeleton = body.skeleton
    rest, positions = np.asarray(body.vertices, float), np.asarray(sequence.vertices, float)
    known = np.asarray(np.isfinite(positions).all(2))
    # use the vertices that all meshes have, except for meshes with few known vertices
    whole = np.asarray(known[known.mean(1) > 0.5].all(0))
    positions = np.where(known[:, :, None], positions, 0.0)[:, whole]
    shares = np.asarray(body.skin.bone_weights(skeleton.num_joints), float).T[:, whole]
    shares = np.equal.outer(np.arange(skeleton.num_joints), skeleton.moving_ancestors) @ shares
    moments = group_moments(shares, rest[whole], np.moveaxis(positions, 0, 1))
    mass = np.where(moments.mass > 0, moments.mass, 1.0)
    cross = moments.cross - moments.target[..., None] * (moments.source / mass[:, None])[:, None, None]
    middles = moments.target / mass[:, None, None]
    follow = PARENT_WEIGHT * np.sum((rest - rest.mean(0)) ** 2)
    frames, joints = len(positions), skeleton.num_joints
    turns, trunk = np.zeros((joints, frames, 3, 3)), nearest_rotation(cross.sum(0))
    for joint, parent in enumerate(skeleton.parents):
        before = trunk if parent < 0 else turns[parent]
        turns[joint] = nearest_rotation(cross[joint] + follow * before)
    centres = np.asarray(skeleton.centres, float)
    translations = np.zeros((joints, frames, 3))
    for joint in (joint for joint, parent in enumerate(skeleton.parents) if parent < 0):
        arm = moments.source[joint] / mass[joint] - centres[joint]
        translations[joint] = middles[joint] - turns[joint] @ arm - centres[joint]
    dtype = body.vertices.dtype
    return _poses_of_rotations(
        skeleton, *(jnp.asarray(np.swapaxes(part, 0, 1), dtype) for part in (translations, turns))
    )


@eqx.filter_jit
def _poses_of_rotations(
    skeleton: Skeleton, translations: Float[Array, "F J 3"], turns: Float[Array, "F J 3 3"]
) -> Pose:
    """Compute the poses in which bones are rotated as by `turns`, as far as the types of the joints allow.

    A joint is rotated relative to its parent as its type allows it to be rotated, not as `turns` has it.
    """
    levels, parents = skeleton.depths, np.maximum(skeleton.parents, 0)
    below = (levels > 0)[:, None, None]

    def pose(shifts: Float[Array, "J 3"], turns: Float[Array, "J 3 3"]) -> Pose:
        scale, one = jnp.ones((), shifts.dtype), jnp.eye(3, dtype=shifts.dtype)

        def descend(level, carry: tuple[Float[Array, "J 3 3"], Pose]):
            allowed, _ = carry
            before = jnp.where(below, allowed[parents], one)
            local = rotation.from_matrix(jnp.swapaxes(before, 1, 2) @ turns)
            found = project(skeleton, Pose(shifts, local, scale))
            reached = before @ rotation.to_matrix(found.rotations)
            return jnp.where((levels == level)[:, None, None], reached, allowed), found

        start = turns, Pose(shifts, rotation.from_matrix(turns), scale)
        return jax.lax.fori_loop(0, levels.max() + 1, descend, start)[1]

    return jax.vmap(pose)(translations, turns)


@eqx.filter_jit
def _fit_all(
    body: Body,
    starts: Pose,
    targets: Float[Array, "F V 3"],
    indices: Int[Array, "C"],
    extra_energy: AbstractEnergy | None,
    max_steps: int,
) -> tuple[Pose, Float[Array, "F"], Int[Array, "F"], Bool[Array, "F"]]:
    def one(frame):
        start, place = frame
        known = jnp.isfinite(place).all(1)
        place = jnp.where(known[:, None], place, 0.0)
        weights = known[indices].astype(place.dtype)
        weights = DATA_WEIGHT * weights / jnp.maximum(weights.sum(), 1.0)
        landmarks = VertexLandmarks(indices, place[indices], weights)
        energy = Sum((landmarks, *(() if extra_energy is None else terms_of(extra_energy))))
        solution = solve(energy, body, start, LevenbergMarquardt(), max_steps)
        gaps = jnp.sum((pose_body(body, solution.pose).vertices - place) ** 2, 1)
        total = known.sum()
        rmse = jnp.sqrt(jnp.sum(jnp.where(known, gaps, 0.0)) / total)
        fine = (solution.result == optx.RESULTS.successful) & jnp.isfinite(rmse)
        pose = jax.tree.map(lambda new, old: jnp.where(jnp.isfinite(rmse), new, old), solution.pose, start)
        return pose, rmse, solution.num_steps, fine

    return jax.lax.map(one, (starts, targets))
