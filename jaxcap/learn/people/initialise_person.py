"""The shape and the poses of another person, from meshes in the topology of a body."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...adapt.shape.joint_regressor import JointRegressor, regress_joints
from ...body.body import Body, posed_vertices
from ...body.pose import Pose, concatenate_poses, shift_roots, take_poses
from ...body.symmetry import symmetrise
from ...fit.fit_meshes import procrustes_poses
from ...observe.meshes import MeshSequence
from ..skeleton.given_centres import GivenCentres, onto_middle
from ..weights.rest_vertices import fit_rest_vertices
from .joints_of_surface import joints_of_surface
from .person import Person
from .rest_alignment import change_rest_pose, check_rest_alignment, rest_pose_of

#: alternations of rest vertices and positions of the body, and of equal lengths and joints on the middle
NUM_ALTERNATIONS = 3
#: alternations of the shape and the rotations of bones
NUM_ALIGNMENTS = 3


class Reference(NamedTuple):
    """The body of the first person, which is given the shape of the others."""

    body: Body
    #: the joints by the surface around them
    regressor: JointRegressor
    #: pairs of left and right joints
    pairs: Int[np.ndarray, "P 2"]
    #: the joints, with the planes of those on the middle
    given: GivenCentres
    #: initial damping of a person
    damping: float


def initialise_person(reference: Reference, targets: Float[Array, "F V 3"]) -> Person:
    """Give a body the shape and the poses of another person's meshes, without iterations of a solver.

    The rotations of the bones are those that each mesh gives by itself (`_align_mesh`), if joints can rest in any pose; otherwise
    those of their vertices (`procrustes_poses`).
    """
    surface_joints = np.stack(
        [regress_joints(reference.regressor, mesh) for mesh in np.asarray(targets, float)]
    )
    poses = procrustes_poses(reference.body, MeshSequence(targets, reference.body.faces))
    if not check_rest_alignment(reference.body.skeleton):
        single = [slice(frame, frame + 1) for frame in range(len(targets))]
        poses = concatenate_poses(
            [
                _align_mesh(reference, take_poses(poses, frame), targets[frame], surface_joints[frame])
                for frame in single
            ]
        )
    return _shape_person(reference, poses, targets, surface_joints)


def _align_mesh(
    reference: Reference,
    pose: Pose,
    target: Float[Array, "1 V 3"],
    surface_joints: Float[np.ndarray, "1 J 3"],
) -> Pose:
    """Rotate the bones in one mesh so that those of the shape at rest, which explains it, are rotated as in the reference.

    The Procrustes rotation of a bone counts vertices near a bent joint, which follow two bones: it is too small. In the shape at
    rest, both bones act on these vertices.

    **Arguments:** `pose`, a stack of one pose.
    """
    for _ in range(NUM_ALIGNMENTS):
        body = _shape_person(reference, pose, target, surface_joints).body
        pose = change_rest_pose(body.skeleton, pose, rest_pose_of(body, reference.body))
    return pose


def _shape_person(
    reference: Reference,
    poses: Pose,
    targets: Float[Array, "F V 3"],
    surface_joints: Float[np.ndarray, "F J 3"],
) -> Person:
    """Compute joints and vertices at rest from the rotations of the bones in each mesh.

    Joints are placed by the surface (`joints_of_surface`), and vertices at rest are then linear least squares.

    **Arguments:** `surface_joints` as of `joints_of_surface`.
    """
    body, given = reference.body, reference.given
    centres, roots = joints_of_surface(body, surface_joints, poses, targets)
    dtype = body.vertices.dtype
    skeleton = eqx.tree_at(lambda s: s.centres, body.skeleton, jnp.asarray(centres, dtype))
    # each moves the joints of the other a little
    for _ in range(NUM_ALTERNATIONS if given.normals is not None else 0):
        skeleton = symmetrise(skeleton, reference.pairs)
        on_middle = onto_middle(skeleton.centres, given)
        skeleton = eqx.tree_at(lambda s: s.centres, skeleton, on_middle)
    skeleton = symmetrise(skeleton, reference.pairs)
    body = eqx.tree_at(lambda b: b.skeleton, body, skeleton)
    first = np.array([parent < 0 for parent in skeleton.parents])
    shifts = np.zeros(poses.translations.shape)
    shifts[:, first] = roots[:, first] - np.asarray(skeleton.centres, float)[first]
    poses = eqx.tree_at(lambda p: p.translations, poses, jnp.asarray(shifts, dtype))
    for _ in range(NUM_ALTERNATIONS):
        body = eqx.tree_at(lambda b: b.vertices, body, fit_rest_vertices(body, poses, targets))
        poses = _centred(body, poses, targets)
    own = GivenCentres(skeleton.centres, given.is_fixed, given.normals)
    return Person(body, poses, targets, own, reference.damping)


@eqx.filter_jit
def _centred(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> Pose:
    """Move the body in each pose by the mean distance of its vertices from their targets."""
    return shift_roots(body.skeleton, poses, jnp.mean(targets - posed_vertices(body, poses), 1))
