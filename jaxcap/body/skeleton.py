"""Skeletons: trees of joints, with their parents, positions and degrees of freedom."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from ..arguments import check_fields, check_length, checked
from ..errors import InputError
from ..stacking import device_array

#: largest angle between bones of one rest pose, degrees; smallest length of compared bones, relative to the
#: skeleton's size
MAX_BONE_ANGLE, MIN_BONE_LENGTH = 20.0, 0.03
#: degrees of freedom of each kind of joint, as (translations, rotations)
KINDS: dict[str, tuple[int, int]] = {
    "fixed": (0, 0),
    "translate": (3, 0),
    "revolute": (0, 1),
    "universal": (0, 2),
    "ball": (0, 3),
    "free": (3, 3),
}


class Skeleton(eqx.Module):
    """A tree of joints, in its rest pose.

    Joint `j` moves bone `j`, the rigid frame of everything attached to it. A joint rotates about its rest
    centre, `T_j = T_parent(j) . Translate(t_j) . Rot(q_j about c_j)` (Adaptation, section 3.1; the same map
    as Kineben, eq. 1). Centres, axes and orientations are in the rest frame of the world, in metres.

    - `fixed`: does not move.
    - `translate`: 3 translations, along the rest axes of the world.
    - `revolute`: rotates about `axes[j, 0]`.
    - `universal`: rotates about `axes[j, 1]`, then about `axes[j, 0]`.
    - `ball`: rotates freely, the update in the body frame, `R <- R exp([dw]x)`.
    - `free`: `translate` and `ball` at once, the usual root.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    parents: tuple[int, ...] = eqx.field(static=True)
    kinds: tuple[str, ...] = eqx.field(static=True)
    centres: Float[Array, "J 3"]
    #: unit quaternions; the x axis of joint `j`'s own frame is its twist axis
    orientations: Float[Array, "J 4"]
    #: unit axes of revolute (the first) and universal (both) joints; other kinds ignore them
    axes: Float[Array, "J 2 3"]

    def __check_init__(self):
        lengths = check_fields(self)
        for name in ("names", "parents", "kinds"):
            check_length(self, name, len(getattr(self, name)), lengths, "J")
        for number, (parent, kind) in enumerate(zip(self.parents, self.kinds, strict=True)):
            if not -1 <= parent < self.num_joints or parent == number or kind not in KINDS:
                raise InputError(
                    f"Skeleton: joint {number}, '{self.names[number]}', has parent {parent} and kind '{kind}'; "
                    "expected the index of another joint, or -1 for a root, and one of the kinds "
                    f"{', '.join(KINDS)}."
                )

    @property
    def num_joints(self) -> int:
        """J, the number of joints (and of bones)."""
        return len(self.names)

    @property
    def num_dofs(self) -> int:
        """D, the number of degrees of freedom: the length of a tangent vector."""
        return sum(sum(KINDS[kind]) for kind in self.kinds)

    @property
    def levels(self) -> tuple[tuple[int, ...], ...]:
        """The joints by their depth in the tree, roots first."""
        depth = self.depths
        return tuple(tuple(np.flatnonzero(depth == d).tolist()) for d in range(max(depth) + 1))

    @property
    def depths(self) -> np.ndarray:
        """(J,) depth of each joint: the number of its ancestors."""
        depth = np.zeros(self.num_joints, int)
        for joint, parent in enumerate(self.parents):
            depth[joint] = 0 if parent < 0 else depth[parent] + 1
        return depth

    @property
    def moving_ancestors(self) -> tuple[int, ...]:
        """For each joint the joint itself if it is not fixed, or its nearest ancestor that is not."""
        found: list[int] = []
        for joint, (parent, kind) in enumerate(zip(self.parents, self.kinds, strict=True)):
            found.append(found[parent] if kind == "fixed" and parent >= 0 else joint)
        return tuple(found)

    @property
    def descendants(self) -> np.ndarray:
        """(J, J) of bool: `descendants[a, d]` is true if bone `d` moves with joint `a`."""
        descends = np.eye(self.num_joints, dtype=bool)
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                descends[:, joint] |= descends[:, parent]
        return descends

    def index(self, name: str) -> int:
        """Return the index of a joint by its name. Raises `KeyError` with the existing names."""
        if name not in self.names:
            raise KeyError(f"There is no joint '{name}'; the skeleton has {', '.join(self.names)}.")
        return self.names.index(name)


class DofLayout(NamedTuple):
    """The slots of each joint's parameters in a tangent vector `d (D,)`; plain NumPy, known at trace time.

    The slot `D` means "no such parameter": gather from `d` with a zero appended.
    """

    #: (J, 3) slots of each joint's translations
    translations: np.ndarray
    #: (J, 3) slots of each joint's rotations
    rotations: np.ndarray
    #: (D,) the joint of each slot
    joints: np.ndarray
    #: (D,) a name for each slot, such as `LeftArm.rx`
    names: tuple[str, ...]


@checked
def dof_layout(skeleton: Skeleton) -> DofLayout:
    """Create the layout of a tangent vector: joint by joint, translations before rotations."""
    total = skeleton.num_dofs
    translations = np.full((skeleton.num_joints, 3), total)
    rotations = np.full((skeleton.num_joints, 3), total)
    joints, names = [], []
    for joint, kind in enumerate(skeleton.kinds):
        for slots, count, label in zip((translations, rotations), KINDS[kind], ("t", "r"), strict=True):
            slots[joint, :count] = np.arange(count) + len(joints)
            joints += [joint] * count
            names += [f"{skeleton.names[joint]}.{label}{'xyz'[i]}" for i in range(count)]
    return DofLayout(translations, rotations, np.array(joints, int), tuple(names))


@checked
def make_skeleton(
    names: Sequence[str],
    parents: Sequence[int],
    kinds: Sequence[str],
    centres,
    orientations=None,
    axes=None,
) -> Skeleton:
    """Create a checked `Skeleton`; joints may come in any order and are sorted parents first.

    **Arguments:** `names` J different names; `parents` J indices into `names`, -1 for a root; `kinds` J of
    `fixed, translate, revolute, universal, ball, free`; `centres (J, 3)` metres; `orientations (J, 4)`
    quaternions, the identity where not given; `axes (J, 2, 3)`, x and y where not given.

    **Raises:** `InputError` with one sentence when names repeat, a parent or a kind is unknown, the tree
    has a cycle, or a number is not finite.
    """
    names, parents, kinds = list(names), [int(p) for p in parents], list(kinds)
    count = len(names)
    centres = np.asarray(centres, float).reshape(-1, 3)
    orientations = (
        np.tile([1.0, 0, 0, 0], (count, 1)) if orientations is None else np.asarray(orientations, float)
    )
    axes = np.tile(np.eye(3)[:2], (count, 1, 1)) if axes is None else np.asarray(axes, float)
    if count == 0:
        raise ValueError("A skeleton needs at least one joint; none was given.")
    if not len(parents) == len(kinds) == len(centres) == len(orientations) == len(axes) == count:
        raise ValueError(
            f"A skeleton with {count} names has {len(parents)} parents, {len(kinds)} kinds and "
            f"{len(centres)} centres; expected one of each for every joint."
        )
    twice = next((name for name, times in Counter(names).items() if times > 1), None)
    if twice is not None:
        raise ValueError(f"The joint name '{twice}' occurs twice; give every joint a unique name.")
    for name, parent, kind in zip(names, parents, kinds, strict=True):
        if not -1 <= parent < count:
            raise ValueError(
                f"Joint '{name}' has parent {parent}; expected a joint from 0 to {count - 1}, or -1 for a root."
            )
        if kind not in KINDS:
            raise ValueError(f"Joint '{name}' has kind '{kind}'; expected one of {', '.join(KINDS)}.")
    for name, centre in zip(names, centres, strict=True):
        if not np.isfinite(centre).all():
            raise ValueError(f"The centre of joint '{name}' is {centre.tolist()}; give three finite numbers.")
    long = np.linalg.norm(orientations, axis=-1)
    if not (np.isfinite(long) & (long > 0)).all():
        wrong = int(np.argmin(np.isfinite(long) & (long > 0)))
        raise ValueError(
            f"The orientation of joint '{names[wrong]}' is {orientations[wrong].tolist()}; expected a finite, "
            "non-zero quaternion."
        )
    if not np.isfinite(axes).all():
        raise ValueError("The axes of a joint are not finite; give two directions of three finite numbers.")
    order = _topological_order(names, parents)
    place = {old: new for new, old in enumerate(order)}
    lengths = np.linalg.norm(axes, axis=-1, keepdims=True)
    return Skeleton(
        names=tuple(names[i] for i in order),
        parents=tuple(-1 if parents[i] < 0 else place[parents[i]] for i in order),
        kinds=tuple(kinds[i] for i in order),
        centres=device_array(centres[order]),
        orientations=device_array((orientations / long[:, None])[order]),
        axes=device_array((axes / np.where(lengths > 0, lengths, 1.0))[order]),
    )


def has_same_joints(first: Skeleton, second: Skeleton) -> bool:
    """Test that two skeletons have the same joints in the same order with the same parents; positions may
    differ."""
    return (first.names, first.parents) == (second.names, second.parents)


def rest_distance(first: Skeleton, second: Skeleton) -> float:
    """Compute the largest distance between the same joint of two skeletons at rest, metres."""
    differences = np.asarray(first.centres, float) - np.asarray(second.centres, float)
    return float(np.linalg.norm(differences, axis=1).max())


def describe_rest_difference(first: Skeleton, second: Skeleton) -> str | None:
    """Describe a difference between two skeletons with the same names by which poses have another meaning;
    None where there is none.

    Such a difference is another parent of a joint, or a bone whose direction at rest differs by more than
    `MAX_BONE_ANGLE` degrees, as between raised and lowered arms. Bone lengths may differ. The words follow "whose".
    """
    for name, parent, there in zip(first.names, first.parents, second.parents, strict=True):
        if parent != there:
            ends = [
                names[p] if p >= 0 else "none" for names, p in ((first.names, parent), (second.names, there))
            ]
            return f"joint '{name}' has parent {ends[0]}, not {ends[1]}"
    bones = [joint for joint, parent in enumerate(first.parents) if parent >= 0]
    above = [first.parents[joint] for joint in bones]
    centres = [np.asarray(skeleton.centres, float) for skeleton in (first, second)]
    long = [there[bones] - there[above] for there in centres]
    length = [np.linalg.norm(bone, axis=1) for bone in long]
    # the direction of a short bone is not reliable
    counts = np.all(
        [
            some > MIN_BONE_LENGTH * np.ptp(there, 0).max()
            for some, there in zip(length, centres, strict=True)
        ],
        0,
    )
    cosine = np.sum(long[0] * long[1], 1) / np.where(counts, length[0] * length[1], 1.0)
    turned = np.degrees(np.arccos(np.clip(cosine, -1, 1))) * counts
    if not turned.max(initial=0.0) > MAX_BONE_ANGLE:
        return None
    worst = int(turned.argmax())
    return (
        f"bone from '{first.names[above[worst]]}' to '{first.names[bones[worst]]}' differs by "
        f"{turned[worst]:.0f} degrees in direction at rest"
    )


def _topological_order(names: list[str], parents: list[int]) -> list[int]:
    """Sort joints parents first: their own order where it is valid, else depth first; a cycle is an error."""
    if all(parent < joint for joint, parent in enumerate(parents)):
        return list(range(len(names)))
    # dictionaries as ordered sets
    order: dict[int, None] = {}
    for joint in range(len(names)):
        chain: dict[int, None] = {}
        while joint >= 0 and joint not in order:
            if joint in chain:
                joints = list(chain)
                cycle = " -> ".join(names[i] for i in [*joints[joints.index(joint) :], joint][:12])
                raise ValueError(f"The skeleton has a cycle: {cycle}. A joint cannot descend from itself.")
            chain[joint] = None
            joint = parents[joint]
        order.update(dict.fromkeys(reversed(chain)))
    return list(order)
