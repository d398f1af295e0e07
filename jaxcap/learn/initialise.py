"""Initialisation of learning: rigid parts, the joints between them, and their poses."""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..body.body import Body
from ..body.pose import Pose
from ..body.skeleton import Skeleton, make_skeleton
from ..body.skin import AbstractSkin, LinearSkin, RigidSkin, SwingTwistSkin
from ..body.skin.swing_twist import swing_twist_from
from ..body.symmetry import find_left_right_pairs, left_right_pairs_by_name, symmetrise
from ..geometry.procrustes import group_moments
from ..observe.meshes import MeshSequence
from ..rigging.rig_mesh import rig_mesh
from .anatomy.find_person import PlacedPerson
from .anatomy.rest_of_template import rest_as_template
from .anatomy.small_joints import free_small_joints
from .parts.find_parts import MAX_SYMMETRY_COST, find_parts
from .parts.surface_graph import make_surface_graph, membership
from .skeleton.given_centres import GivenCentres
from .skeleton.joint_tree import find_joint_tree, pose_parts
from .skeleton.left_right_pairs import detect_left_right_pairs
from .skeleton.pose_from_parts import fit_poses
from .skeleton.reference_mesh import choose_reference_mesh
from .symmetry.surface_symmetry import SurfaceSymmetry
from .symmetry.symmetric_skeleton import make_symmetric

SkinName = Literal["swing_twist", "lbs", "rigid"]


class InitialBody(NamedTuple):
    """The initial body with binary weights and rigid kinematics (Adaptation, 3.2.1), and its poses."""

    body: Body
    poses: Pose
    #: pairs of left and right joints
    left_right_pairs: Int[np.ndarray, "P 2"]
    #: root mean square error over the number of parts, metres; empty for a given skeleton
    curve: Float[np.ndarray, "N"]
    #: where the anatomy or a given skeleton has the joints; None if they were found from the motion
    given: GivenCentres | None = None
    #: the share by which parts in pairs raise the error
    symmetry_cost: float = 0.0


def initialise_from_motion(
    meshes: MeshSequence,
    joints: int | None,
    skin: SkinName,
    symmetry: bool | Int[np.ndarray, "P 2"],
    mirror: SurfaceSymmetry | None = None,
    max_symmetry_cost: float = MAX_SYMMETRY_COST,
) -> InitialBody:
    """Segment the meshes into rigid parts, connect the parts by joints, and pose the skeleton.

    **Arguments:** `joints` is the number of joints, one less than the number of parts; None chooses it from
    the motion. `symmetry` finds the pairs (True), uses none (False), or is the array of pairs. With a `mirror`, the symmetry
    of the surface, parts and joints are on the middle or in pairs, unless that raises the error by a larger share than `max_symmetry_cost`.

    **Raises:** `ValueError` for meshes with fewer parts than requested, and for pairs with invalid joint
    indices.
    """
    shapes, faces = np.asarray(meshes.vertices), np.asarray(meshes.faces)
    rest = shapes[choose_reference_mesh(shapes, faces)]
    parts = find_parts(shapes, faces, None if joints is None else joints + 1, rest, mirror, max_symmetry_cost)
    mirror = mirror if parts.symmetry_cost <= max_symmetry_cost else None
    tree = find_joint_tree(parts, parts.rest, faces, mirror)
    if mirror is None:
        pairs = choose_pairs(symmetry, tree.skeleton, tree.areas)
        skeleton = symmetrise(tree.skeleton, pairs)
    else:
        skeleton, pairs = make_symmetric(tree.skeleton, tree.parts.labels, parts.rest, faces, mirror)
    poses = pose_parts(skeleton, tree.parts, parts.rest)
    body = _bind(skeleton, skin, tree.parts.labels, parts.rest, meshes)
    return InitialBody(body, _cast(poses, meshes), pairs, parts.curve, symmetry_cost=parts.symmetry_cost)


def initialise_from_skeleton(
    meshes: MeshSequence, skeleton: Skeleton, skin: SkinName, symmetry: bool | Int[np.ndarray, "P 2"]
) -> InitialBody:
    """Bind a given skeleton, posed as in the first mesh, by heat weights, and fit its poses to all meshes.

    **Raises:** `InputError` if the skeleton cannot be bound to the mesh.
    """
    shape, faces = np.asarray(meshes.vertices[0], float), np.asarray(meshes.faces)
    labels = np.asarray(rig_mesh(shape, faces, skeleton, "heat").skin.dominant_bones())
    pairs, poses = _pose_bound(meshes, shape, skeleton, labels, symmetry)
    body = _bind(symmetrise(skeleton, pairs), skin, labels, shape, meshes)
    return InitialBody(body, poses, pairs, np.zeros(0), GivenCentres(skeleton.centres))


def initialise_from_person(
    meshes: MeshSequence, placed: PlacedPerson, skin: SkinName, symmetry: bool | Int[np.ndarray, "P 2"]
) -> InitialBody:
    """Begin with the human skeleton as it was placed in one of the meshes, with its weights, and fit its poses to all."""
    shape, skeleton = np.asarray(meshes.vertices[placed.frame], float), placed.body.skeleton
    labels = np.asarray(placed.body.skin.dominant_bones())
    skeleton = free_small_joints(skeleton, shape, np.asarray(meshes.vertices, float), labels)
    pairs, poses = _pose_bound(meshes, shape, skeleton, labels, symmetry)
    body = _bind(symmetrise(skeleton, pairs), skin, labels, shape, meshes)
    dtype = meshes.vertices.dtype
    soft = jax.tree.map(lambda leaf: leaf.astype(dtype), placed.body.skin)
    smooth = {"swing_twist": lambda: swing_twist_from(soft, skeleton), "lbs": lambda: soft}
    if skin in smooth:
        body = eqx.tree_at(lambda b: b.skin, body, smooth[skin]())
    body, poses, given = rest_as_template(body, poses, meshes.vertices, GivenCentres(skeleton.centres))
    if len(pairs):
        given = given._replace(normals=middle_normals(body.skeleton))
    return InitialBody(body, poses, pairs, np.zeros(0), given)


def _pose_bound(
    meshes: MeshSequence,
    shape: Float[np.ndarray, "V 3"],
    skeleton: Skeleton,
    labels: Int[np.ndarray, "V"],
    symmetry: bool | Int[np.ndarray, "P 2"],
) -> tuple[Int[np.ndarray, "P 2"], Pose]:
    """Pair the joints of a skeleton, and fit its poses to all meshes; `labels` are the bones of the vertices of `shape`."""
    shapes = np.asarray(meshes.vertices, float)
    surface = make_surface_graph(shape, shapes, np.asarray(meshes.faces))
    groups = membership(labels, surface.areas, skeleton.num_joints)
    pairs = choose_pairs(symmetry, skeleton, np.asarray(groups.sum(1)).ravel())
    poses = fit_poses(symmetrise(skeleton, pairs), group_moments(groups, shape, shapes.transpose(1, 0, 2)))
    return pairs, _cast(poses, meshes)


def middle_normals(skeleton: Skeleton) -> Float[Array, "J 3"]:
    """Return the lateral axes of the human's joints on the middle of the body, and zero for its other joints."""
    paired = {joint for pair in left_right_pairs_by_name(skeleton.names) for joint in pair}
    middle = [
        parent >= 0 and joint not in paired and skeleton.kinds[joint] != "fixed"
        for joint, parent in enumerate(skeleton.parents)
    ]
    return jnp.where(jnp.array(middle)[:, None], skeleton.axes[:, 0], 0.0)


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
    """Return the pairs of joints: by their names, else by lengths and areas; none, or those given.

    **Raises:** `ValueError` for an invalid joint index.
    """
    if isinstance(symmetry, bool):
        named = find_left_right_pairs(skeleton) if symmetry else ()
        if named:
            return np.array(sorted(named), int)
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
