"""One rest pose of several people: the rotations of bones at rest, which joints' motions hardly determine, are made alike."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...adapt.shape.joint_regressor import make_joint_regressor, regress_joints
from ...body.body import Body
from ...body.kinematics import forward_kinematics
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...fit.fit_meshes import procrustes_poses
from ...geometry import rotation
from ...observe.meshes import MeshSequence
from ..skeleton.given_centres import GivenCentres, replace_centres
from ..weights.rest_vertices import fit_rest_vertices
from .person import Person
from .shape_space import mean_body

#: kinds of joints that can rest in any pose
FREE_KINDS = ("free", "ball", "fixed")


def align_rest_poses(people: Sequence[Person]) -> list[Person]:
    """Rotate the bones of each person at rest as those of the mean, and move the person to its position.

    A body may rest in any pose, which its poses make up for. Differences of rest poses would count as differences of shape. The
    rotation of a bone is that which best aligns its vertices, each group centred, with those of the mean, so that sizes and
    lengths do not count (`procrustes_poses`; SMPL also normalises the pose before principal components). Poses change so that
    bones are where they were; vertices at rest are solved for again. If a joint has fewer axes than three, all people keep their
    rest poses, which a message says: another rest pose would rotate its axes.

    The prior of each person's joints becomes that of the surface around the joints of the mean, which all people determine.
    """
    mean = mean_body([person.body for person in people])
    regressor = make_joint_regressor(mean)
    can_rotate = not check_rest_alignment(mean.skeleton)
    aligned = []
    for person in people:
        if can_rotate:
            person = align_rest_pose(person, mean)
        person = move_to_centre(person, jnp.mean(mean.vertices, 0))
        if not person.given.is_fixed:
            places = jnp.asarray(
                regress_joints(regressor, np.asarray(person.body.vertices, float)), mean.vertices.dtype
            )
            person = person._replace(given=replace_centres(person.given, places))
        aligned.append(person)
    return aligned


def align_rest_pose(person: Person, reference: Body) -> Person:
    """Rotate the bones of a person at rest as those of a body in the same topology.

    **Arguments:** `reference`, with joints that can rest in any pose (`check_rest_alignment`).
    """
    return rotate_at_rest(person, rest_pose_of(person.body, reference))


def rest_pose_of(body: Body, reference: Body) -> Pose:
    """Estimate the pose of a reference that has the bones rotated as those of a body at rest (`procrustes_poses`)."""
    shape = MeshSequence(body.vertices[None], reference.faces)
    return jax.tree.map(lambda leaf: leaf[0], procrustes_poses(reference, shape))


def check_rest_alignment(skeleton: Skeleton) -> list[str]:
    """Return a sentence if joints of a skeleton cannot rest in any pose, so that rest poses are not aligned."""
    bound = [
        name for name, kind in zip(skeleton.names, skeleton.kinds, strict=True) if kind not in FREE_KINDS
    ]
    if not bound:
        return []
    return [
        f"Rest poses of people are not aligned, as joints have fewer axes than three ({', '.join(bound)}): differences of the pose at "
        "rest count as differences of shape; give a skeleton with ball joints."
    ]


def change_rest_pose(skeleton: Skeleton, poses: Pose, pose: Pose) -> Pose:
    """Change poses so that bones are rotated as before from another rest pose: the one from which `pose` leads to the old one.

    With world rotations `H_b` from the old to the new rest pose, bones rotate by `R_b H_b^T` from the new one.
    """
    back = _back_rotations(skeleton, pose)
    first = np.array([parent < 0 for parent in skeleton.parents])
    parents = np.maximum(np.array(skeleton.parents), 0)
    above = jnp.where(first[:, None], rotation.identity(back.dtype), back[parents])

    def turned(rotations: Float[Array, "J 4"]) -> Float[Array, "J 4"]:
        return rotation.multiply(rotation.multiply(above, rotations), rotation.conjugate(back))

    return Pose(poses.translations, rotation.normalise(jax.vmap(turned)(poses.rotations)), poses.scale)


def _back_rotations(skeleton: Skeleton, pose: Pose) -> Float[Array, "J 4"]:
    """Compute the world rotations from the pose to rest."""
    return rotation.from_matrix(jnp.swapaxes(forward_kinematics(skeleton, pose).rotations, 1, 2))


def rotate_at_rest(person: Person, pose: Pose) -> Person:
    """Give a person another rest pose: the one from which `pose` leads to the old one, by the rotations of its bones.

    Bones stay where they are in all poses (`change_rest_pose`).
    """
    skeleton = person.body.skeleton
    first = np.array([parent < 0 for parent in skeleton.parents])
    parents = np.maximum(np.array(skeleton.parents), 0)
    back = _back_rotations(skeleton, pose)
    # what is fixed to the parent at a joint, such as its own arm, turns with the parent
    carry = jnp.where(first[:, None], back, back[parents])
    arms = rotation.rotate(carry, skeleton.centres - skeleton.centres[parents])
    below = jnp.asarray(skeleton.descendants, arms.dtype)
    roots = jnp.where(first[:, None], skeleton.centres, 0.0)
    moved = below.T @ (arms + roots)
    given = person.given
    normals = None if given.normals is None else rotation.rotate(carry, given.normals)
    own = moved + rotation.rotate(carry, given.centres - skeleton.centres)
    body = eqx.tree_at(lambda b: b.skeleton.centres, person.body, moved)
    poses = change_rest_pose(skeleton, person.poses, pose)
    body = eqx.tree_at(
        lambda b: b.vertices, body, fit_rest_vertices(body, poses, person.targets, person.frame_weights)
    )
    return person._replace(body=body, poses=poses, given=GivenCentres(own, given.is_fixed, normals))


def move_to_centre(person: Person, centre: Float[Array, "3"]) -> Person:
    """Move a person at rest so that the mean of its vertices is at `centre`; posed vertices stay."""
    shift = centre - jnp.mean(person.body.vertices, 0)
    roots = jnp.array([parent < 0 for parent in person.body.skeleton.parents])
    body = eqx.tree_at(
        lambda b: (b.vertices, b.skeleton.centres),
        person.body,
        (person.body.vertices + shift, person.body.skeleton.centres + shift),
    )
    back = person.poses.translations - jnp.where(roots[:, None], shift, 0.0)
    poses = Pose(back, person.poses.rotations, person.poses.scale)
    given = person.given._replace(centres=person.given.centres + shift)
    return person._replace(body=body, poses=poses, given=given)
