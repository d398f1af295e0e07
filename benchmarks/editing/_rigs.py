"""CMU takes on rigs of other programs, with other names, joints, rest poses, joint frames, sizes and axes."""

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.matching.upright_pose import joint_transforms

#: joints of the ASF files that a rig is made of; the rest is left out
SIDED = ["clavicle", "humerus", "radius", "wrist", "femur", "tibia", "foot", "toes", "hand"]
TRUNK = ["root", "lowerback", "upperback", "thorax", "lowerneck", "upperneck", "head"]
#: z up, x forward, as Unreal has it
Z_UP = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


class WorldMotion(NamedTuple):
    """A motion of joints in the world."""

    names: list[str]
    parents: list[str | None]
    #: (J, 3) at rest
    centres: list[np.ndarray]
    #: (F,) rotations in the world, from rest
    turns: list[Rotation]
    #: (F, 3) of the first joint
    path: Float[np.ndarray, "F 3"]
    rate: float

    def index(self, name: str) -> int:
        return self.names.index(name)


class Rig(NamedTuple):
    """The properties of a rig."""

    name: str
    #: from the ASF's name to the rig's; with `{s}` for the side: sided joints are given once
    names: dict[str, str]
    #: what stands for `{s}` on the left and on the right
    sides: tuple[str, str]
    #: changes of the tree, before names
    changes: tuple[Callable[[WorldMotion], WorldMotion], ...] = ()
    #: degrees by which each joint's bone hangs at rest below the ASF's T-pose, about the forward axis, by sided ASF name
    bone_angles: Mapping[str, float] = MappingProxyType({})
    #: joints have frames of their own, with bones along x (and along -x on the right), so the rest pose of the file is that of nobody
    has_joint_frames: bool = False
    size: float = 1.0
    #: from the ASF's axes to the rig's
    axes: Float[np.ndarray, "3 3"] = np.eye(3)
    unit: str = "cm"


def world_motion(skeleton: jc.Skeleton, motion: jc.Motion) -> WorldMotion:
    """Select the joints of a take that rigs have."""
    places, turns = joint_transforms(skeleton, motion.poses)
    kept = [*TRUNK, *(side + bone for side in "lr" for bone in SIDED)]
    kept = [name for name in skeleton.names if name in kept]
    parents = []
    for name in kept:
        parent = skeleton.parents[skeleton.index(name)]
        while parent >= 0 and skeleton.names[parent] not in kept:
            parent = skeleton.parents[parent]
        parents.append(None if parent < 0 else skeleton.names[parent])
    rows = [skeleton.index(name) for name in kept]
    centres = np.asarray(skeleton.centres, float)
    return WorldMotion(
        kept,
        parents,
        [centres[row] for row in rows],
        [Rotation.from_quat(turns[:, row][:, [1, 2, 3, 0]]) for row in rows],
        places[:, rows[0]],
        motion.rate,
    )


def remove_joints(*names: str) -> Callable[[WorldMotion], WorldMotion]:
    """Remove joints; their children become children of their parents."""

    def change(acted: WorldMotion) -> WorldMotion:
        parents = list(acted.parents)
        for name in names:
            above = parents[acted.index(name)]
            parents = [above if parent == name else parent for parent in parents]
        kept = [row for row, name in enumerate(acted.names) if name not in names]

        def pick(items):
            return [items[row] for row in kept]

        return acted._replace(
            names=pick(acted.names),
            parents=pick(parents),
            centres=pick(acted.centres),
            turns=pick(acted.turns),
        )

    return change


def with_root(name: str) -> Callable[[WorldMotion], WorldMotion]:
    """Add a root on the floor that follows the hips."""

    def change(acted: WorldMotion) -> WorldMotion:
        floor = acted.centres[0] * [1, 0, 1]
        heading = Rotation.from_rotvec(np.outer(np.linspace(0, 0.5, len(acted.path)), [0, 1, 0]))
        # the hips hang on it, and are where they were
        path = acted.path - heading.apply(acted.centres[0] - floor)
        return acted._replace(
            names=[name, *acted.names],
            parents=[None, name, *acted.parents[1:]],
            centres=[floor, *acted.centres],
            turns=[heading, *acted.turns],
            path=path,
        )

    return change


def with_joint(name: str, above: str, below: str, share: float = 0.5) -> Callable[[WorldMotion], WorldMotion]:
    """Insert a joint between two, with half of their relative rotation."""

    def change(acted: WorldMotion) -> WorldMotion:
        a, b = acted.index(above), acted.index(below)
        step = (acted.turns[a].inv() * acted.turns[b]).as_rotvec()
        return _insert_joint(acted, name, a, b, share, acted.turns[a] * Rotation.from_rotvec(0.5 * step))

    return change


def with_twist(name: str, above: str, below: str) -> Callable[[WorldMotion], WorldMotion]:
    """Insert a joint at the middle of a bone that has all of the bone's twist; the bone's joint only swings."""

    def change(acted: WorldMotion) -> WorldMotion:
        a, b = acted.index(above), acted.index(below)
        parent = acted.turns[acted.index(str(acted.parents[a]))]
        twist = _twist(parent.inv() * acted.turns[a], acted.centres[b] - acted.centres[a])
        whole = acted.turns[a]
        changed = _insert_joint(acted, name, a, b, 0.5, whole)
        changed.turns[a] = whole * twist.inv()
        return changed

    return change


def with_half_twist(name: str, above: str, below: str) -> Callable[[WorldMotion], WorldMotion]:
    """Insert a joint at the middle of a bone that has half of the twist of the bone's child."""

    def change(acted: WorldMotion) -> WorldMotion:
        a, b = acted.index(above), acted.index(below)
        bone = acted.centres[b] - acted.centres[a]
        angle = 0.5 * _twist(acted.turns[a].inv() * acted.turns[b], bone).as_rotvec()
        return _insert_joint(acted, name, a, b, 0.5, acted.turns[a] * Rotation.from_rotvec(angle))

    return change


def with_leaf(name: str, above: str, below: str) -> Callable[[WorldMotion], WorldMotion]:
    """Add a leaf joint at the middle of a bone."""

    def change(acted: WorldMotion) -> WorldMotion:
        a, b = acted.index(above), acted.index(below)
        changed = _insert_joint(acted, name, a, b, 0.5, acted.turns[a])
        changed.parents[changed.index(below)] = above
        return changed

    return change


def reparent(name: str, above: str) -> Callable[[WorldMotion], WorldMotion]:
    """Change the parent of a joint, which keeps its position."""

    def change(acted: WorldMotion) -> WorldMotion:
        parents = [
            above if own == name else parent for own, parent in zip(acted.names, acted.parents, strict=True)
        ]
        return acted._replace(parents=parents)

    return change


def on_both_sides(
    make: Callable[..., Callable[[WorldMotion], WorldMotion]], *names: str
) -> tuple[Callable[[WorldMotion], WorldMotion], ...]:
    """Make a change for both sides; `{s}` in the names is l and r."""
    return tuple(make(*(name.format(s=side) for name in names)) for side in "lr")


def make_rig(acted: WorldMotion, rig: Rig) -> tuple[jc.Skeleton, jc.Motion]:
    """Build the rig of a take; joints without a name in the rig are removed."""
    for change in rig.changes:
        acted = change(acted)
    acted = remove_joints(*(name for name in acted.names if _rig_names([name], rig)[0] is None))(acted)
    count, frames = len(acted.names), len(acted.path)
    parents = [-1 if parent is None else acted.index(parent) for parent in acted.parents]
    axes = Rotation.from_matrix(rig.axes)
    # the rotation, at the ASF's rest, from the rig's joint frames to the world
    own = [_frame(acted, row, rig) for row in range(count)]
    centres, rotations = np.zeros((count, 3)), np.zeros((frames, count, 4))
    whole: list[Rotation] = []
    for row, parent in enumerate(parents):
        whole.append(acted.turns[row] * own[row])
        if parent < 0:
            centres[row] = axes.apply(acted.centres[row])
            local = whole[row]
        else:
            offset = own[parent].inv().apply(acted.centres[row] - acted.centres[parent])
            centres[row] = centres[parent] + axes.apply(offset)
            local = whole[parent].inv() * whole[row]
        rotations[:, row] = (axes * local * axes.inv()).as_quat()[:, [3, 0, 1, 2]]
    translations = np.zeros((frames, count, 3))
    translations[:, 0] = axes.apply(acted.path) - centres[0]
    kinds = ["free"] + ["ball"] * (count - 1)
    skeleton = jc.make_skeleton(
        [str(name) for name in _rig_names(acted.names, rig)], parents, kinds, rig.size * centres
    )
    poses = jc.Pose(
        np.asarray(rig.size * translations, np.float32),  # pyright: ignore[reportArgumentType]
        np.asarray(rotations, np.float32),  # pyright: ignore[reportArgumentType]
        np.ones(frames, np.float32),  # pyright: ignore[reportArgumentType]
    )
    return skeleton, jc.Motion(poses, acted.rate)


def _rig_names(names: Sequence[str], rig: Rig) -> list[str | None]:
    found: list[str | None] = []
    for name in names:
        side = rig.sides["lr".index(name[0])] if name[0] in "lr" and name[1:] in rig.names else ""
        called = rig.names.get(name[1:] if side else name)
        found.append(None if called is None else called.format(s=side))
    return found


def _frame(acted: WorldMotion, row: int, rig: Rig) -> Rotation:
    """Compute the rotation of a joint's frame at the ASF's rest pose; the file's own frames have none."""
    if not rig.has_joint_frames:
        name = acted.names[row]
        # a joint along a bone hangs as the bone does
        angle = np.radians(rig.bone_angles.get(name[1:].split("_")[0], 0.0)) * (
            1 if name.startswith("l") else -1
        )
        # what hangs down at the rig's rest has to be turned up to be as the ASF's rest has it
        return Rotation.from_rotvec([0, 0, angle]) if angle else Rotation.identity()
    below = [child for child, parent in enumerate(acted.parents) if parent == acted.names[row]]
    bone = (acted.centres[below[0]] - acted.centres[row]) if below else np.array([0, 1.0, 0])
    if np.linalg.norm(bone) < 1e-6 or acted.parents[row] is None:
        return Rotation.identity()
    way = np.array([1.0, 0, 0]) * (
        -1 if acted.names[row].startswith("r") and acted.names[row] != "root" else 1
    )
    turn = Rotation.align_vectors(bone[None], way[None])[0]
    # and about the bone by another angle for each joint, which no rest pose shows
    return turn * Rotation.from_rotvec(0.7 * (row % 5) * way)


def _twist(turns: Rotation, bone: np.ndarray) -> Rotation:
    """Extract the twist of rotations about a bone, which is applied first."""
    bone = bone / np.linalg.norm(bone)
    quaternions = turns.as_quat()
    along = quaternions[:, :3] @ bone
    return Rotation.from_quat(np.concatenate([along[:, None] * bone, quaternions[:, 3:]], 1))


def _insert_joint(acted: WorldMotion, name: str, a: int, b: int, share: float, turn: Rotation) -> WorldMotion:
    centre = (1 - share) * acted.centres[a] + share * acted.centres[b]
    parents = [name if row == b else parent for row, parent in enumerate(acted.parents)]
    return acted._replace(
        names=[*acted.names[:b], name, *acted.names[b:]],
        parents=[*parents[:b], acted.names[a], *parents[b:]],
        centres=[*acted.centres[:b], centre, *acted.centres[b:]],
        turns=[*acted.turns[:b], turn, *acted.turns[b:]],
    )
