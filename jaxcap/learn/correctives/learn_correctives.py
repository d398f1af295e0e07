"""Learn pose-dependent displacements of a body from registered meshes, where they lower the errors of unseen poses."""

import logging
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...arguments import checked
from ...body.body import Body, take_vertices
from ...body.pose import Motion, Pose
from ...body.skin import CorrectedSkin, RotationMatrixFeatures
from ...body.skin.corrected import corrective_units
from ...body.skin.low_rank import factorise_by_joint
from ...energy.check_energies import UserTerms
from ...errors import InputError
from ...fit.fit_meshes import check_mesh_sequence, fit_meshes
from ...observe.meshes import MeshSequence
from ..anatomy.joint_evidence import largest_rotations
from ..variable_projection.solve_blend_problem import sample_vertices
from .choose import CorrectiveChoice, choose_correctives
from .equations import CorrectiveEquations, make_equations, solve_directions
from .near_joints import find_near_joints, list_columns
from .pose_basis import PoseBasis, make_pose_basis, pose_values

_LOG = logging.getLogger(__name__)

#: least number of meshes, and least rotation of the joint that rotates most from its mean, degrees
MIN_MESHES, MIN_ROTATION = 8, 10.0
#: vertices for the choice of strength and rank, and for the poses
CHOICE_VERTICES, POSE_VERTICES = 300, 1000
#: what displacements depend on, as in SMPL
FEATURES = RotationMatrixFeatures()


class JointCorrectives(NamedTuple):
    """The displacements by the rotation of each joint, over the poses of the meshes."""

    names: tuple[str, ...]
    #: indices of the joints in the skeleton, those that displace the surface only
    joints: Int[np.ndarray, "N"]
    #: number of units of the joint
    ranks: Int[np.ndarray, "N"]
    #: largest displacement of a vertex, and the root mean square over the vertices that the joint displaces, metres
    largest: Float[np.ndarray, "N"]
    rms: Float[np.ndarray, "N"]


class LearnedCorrectives(NamedTuple):
    """A body with correctives, the poses of its meshes, and the evidence for the correctives."""

    #: unchanged if left-out poses are not better with correctives
    body: Body
    motion: Motion
    choice: CorrectiveChoice
    by_joint: JointCorrectives

    @property
    def is_used(self) -> bool:
        """Whether the body has correctives."""
        return self.choice.is_gain


@checked
def learn_correctives(
    body: Body, motion: Motion, meshes: MeshSequence, terms: UserTerms = ()
) -> LearnedCorrectives:
    """Learn displacements of the surface at rest that depend on the pose, for a body in the poses of its meshes.

    The displacement of a vertex is linear in the entries of `R_j - I` for the joints near it: those of the bones that
    influence it, and their neighbours in the tree. A Gaussian prior keeps the displacements small. For each joint they
    have a low rank. The strength of the prior and the rank are those with the least error of poses that are left out of
    the fit, fold by fold; each fold has successive meshes. If correctives do not lower this error by more than one
    standard error, the body is returned unchanged. The shape at rest and the poses are fitted again with the correctives.

    **Arguments:** `motion` are the poses of the body in the meshes, such as those of `learn_body`; `terms` are energies of the
    posed body, as of `fit_meshes`, that also hold where the poses are fitted again.

    The shape at rest is then that of the least squared distances, without the smoothness of `learn_body`. A pose that
    cannot be fitted again stays.

    **Raises:** `InputError` if there are fewer than `MIN_MESHES` meshes, if no joint rotates by `MIN_ROTATION` degrees, if
    the body has correctives already or bones without parents, if meshes, poses and body do not fit each other, or if a number
    is not finite.
    """
    _check(body, motion, meshes)
    targets = meshes.vertices.astype(body.vertices.dtype)
    labels = np.asarray(body.skin.dominant_bones())
    some = sample_vertices(labels, min(CHOICE_VERTICES, len(labels)))
    _LOG.info("correctives: strength and rank by left-out poses")
    equations, basis = _equations(take_vertices(body, jnp.asarray(some)), motion.poses, targets[:, some])
    choice = choose_correctives(equations, basis.joints)
    if not choice.is_gain:
        nothing = JointCorrectives((), np.zeros(0, int), np.zeros(0, int), np.zeros(0), np.zeros(0))
        return LearnedCorrectives(body, motion, choice, nothing)
    _LOG.info("correctives: poses")
    some = sample_vertices(labels, min(POSE_VERTICES, len(labels)))
    if terms:
        # terms need all vertices
        corrected = fit_correctives(body, motion.poses, targets, choice.strength, choice.rank)
        fit = fit_meshes(corrected, meshes, start=motion.poses, vertices=some, terms=terms)
    else:
        sampled = take_vertices(body, jnp.asarray(some))
        sampled = fit_correctives(sampled, motion.poses, targets[:, some], choice.strength, choice.rank)
        registered = MeshSequence(targets[:, some], sampled.faces, meshes.rate)
        fit = fit_meshes(sampled, registered, start=motion.poses)
    motion = Motion(_where(fit.converged, fit.motion.poses, motion.poses), motion.rate)
    _LOG.info("correctives: displacements")
    body = fit_correctives(body, motion.poses, targets, choice.strength, choice.rank)
    return LearnedCorrectives(body, motion, choice, measure_correctives(body, motion))


def fit_correctives(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"], strength: float, rank: int
) -> Body:
    """Fit correctives with a given strength and rank, and the shape at rest, to meshes in given poses.

    Directions of full rank are fitted first, then approximated for each joint.
    """
    dtype = body.vertices.dtype
    equations, basis = _equations(body, poses, targets)
    shift, directions = solve_directions(equations, jnp.asarray(strength, dtype))
    found = factorise_by_joint(
        np.asarray(directions), np.asarray(equations.values, float), basis.joints, rank
    )
    layer = jnp.asarray(found.layer @ basis.rows, dtype)
    skin = CorrectedSkin(body.skin, FEATURES, jnp.asarray(found.directions, dtype), layer, rectified=False)
    return eqx.tree_at(lambda b: (b.vertices, b.skin), body, (body.vertices + shift, skin))


def _where(use: Bool[Array, "F"], poses: Pose, others: Pose) -> Pose:
    """Choose between two poses for each frame."""
    return jax.tree.map(
        lambda one, other: jnp.where(use.reshape(-1, *[1] * (one.ndim - 1)), one, other), poses, others
    )


@checked
def measure_correctives(body: Body, motion: Motion) -> JointCorrectives:
    """Measure the displacements of a surface by each joint over the poses of a motion.

    **Raises:** `InputError` if the body has no correctives that `learn_correctives` learned.
    """
    skin = body.skin
    if not isinstance(skin, CorrectedSkin) or skin.layer is None or skin.rectified:
        raise InputError(
            "measure_correctives: the displacements of this body are not those of `learn_correctives`."
        )
    units = np.asarray(corrective_units(skin, motion.poses), float)
    directions, blocks = np.asarray(skin.directions, float), np.asarray(skin.layer)
    owners = 1 + blocks.reshape(len(blocks), -1, skin.features.num_of_joint).any(2).argmax(1)
    joints = np.unique(owners)
    moved = [
        np.linalg.norm(block[block.any((1, 2))] @ units[:, owners == joint].T, axis=1)
        for joint in joints
        for block in (directions[:, :, owners == joint],)
    ]
    return JointCorrectives(
        tuple(body.skeleton.names[joint] for joint in joints),
        joints,
        np.array([np.sum(owners == joint) for joint in joints], int),
        np.array([lengths.max(initial=0.0) for lengths in moved]),
        np.array([np.sqrt(np.mean(lengths**2)) if lengths.size else 0.0 for lengths in moved]),
    )


def _equations(
    body: Body, poses: Pose, targets: Float[Array, "F V 3"]
) -> tuple[CorrectiveEquations, PoseBasis]:
    """Linearise the residuals by the combinations of features that vary in the poses."""
    values = np.asarray(pose_values(FEATURES, poses), float)
    basis = make_pose_basis(values, FEATURES.num_of_joint)
    reduced = jnp.asarray(values @ basis.rows.T, body.vertices.dtype)
    columns = list_columns(find_near_joints(body)[:, basis.joints])
    return make_equations(body, poses, targets, reduced, *columns), basis


def _check(body: Body, motion: Motion, meshes: MeshSequence) -> None:
    check_mesh_sequence(body, meshes)
    parents = body.skeleton.parents
    if isinstance(body.skin, CorrectedSkin):
        raise InputError(
            "learn_correctives: the body has correctives already; give one without, such as that of `learn_body`."
        )
    if sum(parent < 0 for parent in parents) > 1:
        raise InputError(
            "learn_correctives: the bones of this body have no parents, so that no joint bends the surface; give a body with a tree "
            "of joints."
        )
    if motion.num_frames != len(meshes):
        raise InputError(
            f"learn_correctives: there are {motion.num_frames} poses and {len(meshes)} meshes; expected one pose for each mesh."
        )
    if len(meshes) < MIN_MESHES:
        raise InputError(
            f"learn_correctives: there are {len(meshes)} meshes; expected at least {MIN_MESHES}, as some poses are left out to "
            "measure the gain."
        )
    for name, part in {"meshes": meshes.vertices, "poses": motion.poses}.items():
        leaves = [np.asarray(leaf).reshape(len(meshes), -1) for leaf in jax.tree.leaves(part)]
        wrong = ~np.isfinite(np.concatenate(leaves, 1)).all(1)
        if wrong.any():
            raise InputError(
                f"learn_correctives: the {name} {np.flatnonzero(wrong)[:5].tolist()} hold numbers that are not finite; leave these "
                "out."
            )
    turned = largest_rotations(np.asarray(motion.poses.rotations, float))[np.array(parents) >= 0]
    if not turned.max(initial=0.0) >= MIN_ROTATION:
        raise InputError(
            f"learn_correctives: no joint rotates by more than {turned.max(initial=0.0):.1f} degrees from its mean; expected at least "
            f"{MIN_ROTATION:g}: give meshes in which the joints bend."
        )
