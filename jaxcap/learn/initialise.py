"""Initialisation of learning: rigid parts, the joints between them, and their poses."""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body
from ..body.pose import Pose
from ..body.skeleton import Skeleton, make_skeleton
from ..body.skin import AbstractSkin, LinearSkin, RigidSkin, SwingTwistSkin
from ..body.symmetry import symmetrise
from ..geometry.procrustes import group_moments
from ..observe.meshes import MeshSequence
from ..rigging.rig_mesh import rig_mesh
from .parts.find_parts import find_parts
from .parts.surface_graph import make_surface_graph, membership
from .skeleton.joint_tree import find_joint_tree, pose_parts
from .skeleton.left_right_pairs import detect_left_right_pairs
from .skeleton.pose_from_parts import fit_poses
from .skeleton.reference_mesh import choose_reference_mesh

SkinName = Literal["swing_twist", "lbs", "rigid"]


class InitialBody(NamedTuple):
    """The initial body with binary weights and rigid kinematics (Adaptation, 3.2.1), and its poses."""

    body: Body
    poses: Pose
    #: pairs of left and right joints
    left_right_pairs: Int[np.ndarray, "P 2"]
    #: root mean square error over the number of parts, metres; empty for a given skeleton
    curve: Float[np.ndarray, "N"]


def initialise_from_motion(
    meshes: MeshSequence, joints: int | None, skin: SkinName, symmetry: bool | Int[np.ndarray, "P 2"]
) -> InitialBody:
    """Segment the meshes into rigid parts, connect the parts by joints, and pose the skeleton.

    **Arguments:** `joints` is the number of joints, one less than the number of parts; None chooses it from
    the motion. `symmetry` finds the pairs (True), uses none (False), or is the array of pairs.

    **Raises:** `ValueError` for meshes with fewer parts than requested, and for pairs with invalid joint
    indices.
    """
    shapes, faces = np.asarray(meshes.vertices), np.asarray(meshes.faces)
    rest = shapes[choose_reference_mesh(shapes, faces)]
    parts = find_parts(shapes, faces, None if joints is None else joints + 1, rest)
    tree = find_joint_tree(parts, parts.rest, faces)
    pairs = choose_pairs(symmetry, tree.skeleton, tree.areas)
    skeleton = symmetrise(tree.skeleton, pairs)
    poses = pose_parts(skeleton, tree.parts, parts.rest)
    body = _bind(skeleton, skin, tree.parts.labels, parts.rest, meshes)
    return InitialBody(body, _cast(poses, meshes), pairs, parts.curve)


def initialise_from_skeleton(
    meshes: MeshSequence, skeleton: Skeleton, skin: SkinName, symmetry: bool | Int[np.ndarray, "P 2"]
) -> InitialBody:
    """Bind a given skeleton, posed as in the first mesh, by heat weights, and fit its poses to all meshes.

    **Raises:** `InputError` if the skeleton cannot be bound to the mesh.
    """
    shapes, faces = np.asarray(meshes.vertices, float), np.asarray(meshes.faces)
    labels = np.asarray(rig_mesh(shapes[0], faces, skeleton, "heat").skin.dominant_bones())
    surface = make_surface_graph(shapes[0], shapes, faces)
    groups = membership(labels, surface.areas, skeleton.num_joints)
    areas = np.asarray(groups.sum(1)).ravel()
    pairs = choose_pairs(symmetry, skeleton, areas)
    skeleton = symmetrise(skeleton, pairs)
    poses = fit_poses(skeleton, group_moments(groups, shapes[0], shapes.transpose(1, 0, 2)))
    return InitialBody(
        _bind(skeleton, skin, labels, shapes[0], meshes), _cast(poses, meshes), pairs, np.zeros(0)
    )


def initialise_free_bones(meshes: MeshSequence, joints: int | None) -> InitialBody:
    """Build a body of independent bones: each rigid part has a free root at its mean vertex.

    **Raises:** `ValueError` for meshes with fewer parts than requested.
    """
    shapes, faces = np.asarray(meshes.vertices), np.asarray(meshes.faces)
    rest = shapes[choose_reference_mesh(shapes, faces)]
    parts = find_parts(shapes, faces, None if joints is None else joints + 1, rest)
    names = [f"bone{part}" for part in range(parts.num_parts)]
    middles = [parts.rest[parts.labels == part].mean(0) for part in range(parts.num_parts)]
    skeleton = make_skeleton(names, [-1] * len(names), ["free"] * len(names), middles)
    body = _bind(skeleton, "lbs", parts.labels, parts.rest, meshes)
    poses = _cast(pose_parts(skeleton, parts, parts.rest), meshes)
    return InitialBody(body, poses, np.zeros((0, 2), int), parts.curve)


def choose_pairs(
    symmetry: bool | Int[np.ndarray, "P 2"], skeleton: Skeleton, areas: Float[np.ndarray, "J"]
) -> Int[np.ndarray, "P 2"]:
    """Return the detected pairs of joints, none, or those given.

    **Raises:** `ValueError` for an invalid joint index.
    """
    if isinstance(symmetry, bool):
        return detect_left_right_pairs(skeleton, areas) if symmetry else np.zeros((0, 2), int)
    pairs = np.asarray(symmetry, int).reshape(-1, 2)
    wrong = pairs[(pairs < 0) | (pairs >= skeleton.num_joints)]
    if len(wrong):
        raise ValueError(
            f"The left-right pairs have the joint index {wrong[0]}; expected indices from 0 to "
            f"{skeleton.num_joints - 1}."
        )
    return pairs


def _bind(skeleton, skin: SkinName, labels, rest, meshes: MeshSequence) -> Body:
    dtype, bones = meshes.vertices.dtype, jnp.asarray(labels, jnp.int32)
    count = skeleton.num_joints
    none = jnp.zeros((len(bones), count), dtype)
    skins: dict[str, AbstractSkin] = {
        "swing_twist": SwingTwistSkin(bones, none, none),
        "lbs": LinearSkin(none.at[jnp.arange(len(bones)), bones].set(1.0)),
        "rigid": RigidSkin(bones),
    }
    if skin not in skins:
        raise ValueError(f"The skin '{skin}' is unknown; expected one of {', '.join(skins)}.")
    return Body(skeleton, skins[skin], jnp.asarray(rest, dtype), meshes.faces)


def _cast(poses: Pose, meshes: MeshSequence) -> Pose:
    dtype = meshes.vertices.dtype
    return Pose(*(jnp.asarray(field, dtype) for field in (poses.translations, poses.rotations, poses.scale)))
