"""A person while one body is learned from several people."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...adapt.shape.joint_regressor import JointRegressor, regress_joints
from ...body.body import Body, posed_vertices
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose, shift_roots, take_poses
from ...body.symmetry import symmetrise
from ...fit.fit_meshes import procrustes_poses
from ...observe.meshes import MeshSequence
from ..anatomy.joint_evidence import MIN_LENGTH
from ..skeleton.joint_centre_prior import GivenCentres
from ..weights.rest_vertices import fit_rest_vertices

#: rotation of a joint, radians, from which on a mesh counts little for the position of its centre by the surface
MAX_BEND = 0.35
#: alternations of rest vertices and positions of the body
NUM_ALTERNATIONS = 3


#: numbers of meshes for which functions are compiled
LENGTHS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)


class Person(NamedTuple):
    """The shared body in the shape of one person, with the person's meshes and their poses."""

    body: Body
    poses: Pose
    targets: Float[Array, "F V 3"]
    #: where the surface has the joints
    given: GivenCentres
    damping: float
    #: Q of this person's meshes, squared metres
    value: float = np.inf
    #: one for the meshes of the person, and zero for repeated ones (`repeat_meshes`), which follow; None without repeated ones
    frame_weights: Float[Array, "F"] | None = None

    @property
    def num_meshes(self) -> int:
        """The number of meshes without repeated ones."""
        return len(self.targets) if self.frame_weights is None else int(np.sum(self.frame_weights))


def repeat_meshes(person: Person) -> Person:
    """Append the first meshes of a person, with weight zero, until their number is one of `LENGTHS`.

    Functions are compiled for each number of meshes.
    """
    count = len(person.targets)
    rows = repeated_rows(count)
    return person._replace(
        poses=take_poses(person.poses, rows),
        targets=person.targets[rows],
        frame_weights=jnp.asarray(np.arange(len(rows)) < count, person.targets.dtype),
    )


def repeated_rows(count: int) -> Int[np.ndarray, "F"]:
    """Number the meshes of a person from 0, and again from 0 until there are as many as one of `LENGTHS`."""
    return np.arange(next((length for length in LENGTHS if length >= count), count)) % count


def initialise_person(
    reference: Body,
    regressor: JointRegressor,
    targets: Float[Array, "F V 3"],
    pairs: Int[np.ndarray, "P 2"],
    given: GivenCentres,
    damping: float,
) -> Person:
    """Give a body the shape and the poses of another person's meshes, without iterations of a solver.

    Bones rotate as their vertices do (`procrustes_poses`), so that the rest pose is that of the reference. Joints are placed by
    the surface around them (`regress_joints`), mostly in the meshes in which they bend little, and vertices at rest are then
    linear least squares.

    **Arguments:** `given`, the joints of the reference with the planes of those on its middle.
    """
    meshes = MeshSequence(targets, reference.faces)
    poses = procrustes_poses(reference, meshes)
    centres, roots = joints_of_surface(reference, regressor, poses, targets)
    dtype = reference.vertices.dtype
    skeleton = eqx.tree_at(lambda s: s.centres, reference.skeleton, jnp.asarray(centres, dtype))
    skeleton = symmetrise(skeleton, pairs)
    if given.normals is not None:
        on_middle = onto_middle(skeleton.centres, given)
        skeleton = eqx.tree_at(lambda s: s.centres, skeleton, on_middle)
    body = eqx.tree_at(lambda b: b.skeleton, reference, skeleton)
    first = np.array([parent < 0 for parent in skeleton.parents])
    shifts = np.zeros(poses.translations.shape)
    shifts[:, first] = roots[:, first] - np.asarray(skeleton.centres, float)[first]
    poses = eqx.tree_at(lambda p: p.translations, poses, jnp.asarray(shifts, dtype))
    for _ in range(NUM_ALTERNATIONS):
        body = eqx.tree_at(lambda b: b.vertices, body, fit_rest_vertices(body, poses, targets))
        poses = _centred(body, poses, targets)
    own = GivenCentres(skeleton.centres, given.is_fixed, given.normals)
    return Person(body, poses, targets, own, damping)


def joints_of_surface(
    reference: Body, regressor: JointRegressor, poses: Pose, targets: Float[Array, "F V 3"]
) -> tuple[Float[np.ndarray, "J 3"], Float[np.ndarray, "F J 3"]]:
    """Estimate the joints of a person at rest, and in each mesh, from the surface around them, given the rotations of bones."""
    skeleton = reference.skeleton
    posed = np.stack([regress_joints(regressor, mesh) for mesh in np.asarray(targets, float)])
    turns = np.asarray(_bone_rotations(skeleton, poses), float)
    cosines = np.clip(np.abs(np.asarray(poses.rotations, float)[..., 0]), 0.0, 1.0)
    bends = 2 * np.arccos(cosines)
    parents = np.array(skeleton.parents)
    bends[:, parents < 0] = 0.0
    weights = 1.0 / (1.0 + (bends / MAX_BEND) ** 2) ** 2
    rest = np.asarray(skeleton.centres, float)
    centres = rest.copy()
    for joint, parent in enumerate(parents):
        if parent < 0:
            continue
        if np.linalg.norm(rest[joint] - rest[parent]) < MIN_LENGTH:
            centres[joint] = centres[parent]
            continue
        bones = np.einsum("fba,fb->fa", turns[:, parent], posed[:, joint] - posed[:, parent])
        shares = weights[:, joint] * weights[:, parent]
        centres[joint] = centres[parent] + shares @ bones / shares.sum()
    return centres, posed


def onto_middle(centres: Float[Array, "J 3"], given: GivenCentres) -> Float[Array, "J 3"]:
    """Move the joints on the middle of the body sideways, so that all are as far from the given planes."""
    assert given.normals is not None
    away = jnp.sum((centres - given.centres) * given.normals, 1)
    members = jnp.any(given.normals != 0, 1)
    mean = jnp.sum(away * members) / jnp.maximum(members.sum(), 1)
    return centres + jnp.where(members, mean - away, 0.0)[:, None] * given.normals


@eqx.filter_jit
def _bone_rotations(skeleton, poses: Pose) -> Float[Array, "F J 3 3"]:
    return jax.vmap(lambda pose: forward_kinematics(skeleton, pose).rotations)(poses)


@eqx.filter_jit
def _centred(body: Body, poses: Pose, targets: Float[Array, "F V 3"]) -> Pose:
    """Move the body in each pose by the mean distance of its vertices from their targets."""
    return shift_roots(body.skeleton, poses, jnp.mean(targets - posed_vertices(body, poses), 1))
