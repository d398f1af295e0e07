"""Anatomical axes of the segments of a person, from the joint centres in an upright pose.

Axes are X forward, Y up or towards the trunk, Z to the right, on both sides of the body, as in Wu et al. 2002 and
2005. Their landmarks lie on the skin and the bones, which a skeleton does not have; joint centres, hinge axes and
the direction in which the person looks replace them (`docs/joint_angles.md`).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from ..arguments import check_fields, checked
from ..body.matching.names import Side
from ..body.matching.pairing import SIDES
from ..body.matching.person_joints import PersonJoints, far_end, identify_joints
from ..body.matching.sides import UnknownSides, toes_point_backward
from ..body.matching.upright_pose import UprightPose, find_upright_pose
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..errors import InputError
from ..geometry.axes import nearest_signed_permutation
from .conventions import SEGMENTS

#: least bend of an elbow in the upright pose that shows its axis, radians
MIN_BEND = np.radians(10.0)
#: least sine between a bone and the direction that completes its axes
MIN_SINE = 0.17
#: largest angle between the axis of a hinge at the wrist and the forearm, if the hinge is that of pronation
MAX_TWIST_ANGLE = np.radians(30.0)

#: names of a trunk without arms
TRUNK_NAMES = ("torso", "thorax", "trunk", "chest")

Vector = Float[np.ndarray, "3"]
Axes = Float[np.ndarray, "3 3"]
#: bone of a segment, and its axes
Segment = tuple[int, Axes]


class AnatomicalFrames(eqx.Module):
    """The axes of the segments of a skeleton at rest, S segments."""

    #: as in `SEGMENTS`, such as `femur_r`
    segments: tuple[str, ...] = eqx.field(static=True)
    #: joint with which each segment moves
    bones: tuple[int, ...] = eqx.field(static=True)
    #: segments that the skeleton does not have
    missing: tuple[str, ...] = eqx.field(static=True)
    #: rotation matrices in the world, for the skeleton at rest; columns X, Y and Z
    axes: Float[Array, "S 3 3"]
    #: axes of the world, against which the pelvis is measured; each is a coordinate axis
    world: Float[Array, "3 3"]

    def __check_init__(self):
        check_fields(self)


@checked
def find_anatomical_frames(skeleton: Skeleton, motion: Motion | None = None) -> AnatomicalFrames:
    """Find the segments of a person and their anatomical axes, by joint names, joint centres and hinges.

    - Pelvis, thorax and head: Y vertical, Z along the line of the hips, of the shoulders, and across the person.
    - Femur and tibia: Y along the bone, Z nearest to the axis of the knee if that is a hinge, else to the
      person's right.
    - Foot: X horizontal, as on a flat floor, in the plane of the shank and the line from the ankle to the toes, else
      forward.
    - Humerus: Y along the bone, Z along the axis of the elbow: of its hinge, else the normal of an arm that is bent
      by 10 degrees or more, else such that the elbow flexes forward.
    - Forearm and hand: Y along the bone, Z towards the thumb on the right side, away from it on the left: across
      the knuckles of index and little finger, else to the thumb, else the thumb points forward.

    A segment moves with its last joint before the next segment, that is, with the distal end of a bone that has
    twist joints.

    **Arguments:** `motion` is for skeletons whose rest pose is not that of a person, such as those of files in which
    every joint has its own axes: the straightest frame replaces it.

    **Raises:** `InputError` if there is no person with sides and an upright pose in the skeleton.
    """
    upright = find_upright(skeleton, motion)
    axes = _legs_axes(upright) if upright.axes is None else upright.axes
    if axes is None:
        raise InputError(
            f"The joints {', '.join(skeleton.names[:12])} are not recognised as a person with a left and a right side; "
            "rename them, for example as in SMPL or as in `jaxcap.human`."
        )
    found = {**_find_trunk(skeleton, upright, axes), **_find_limbs(skeleton, upright, axes)}
    whole = Rotation.from_quat(upright.rotations[:, [1, 2, 3, 0]]).as_matrix()
    named = [name for name in SEGMENTS if name in found]
    bones = [found[name][0] for name in named]
    rest = [whole[bone].T @ found[name][1] for name, bone in zip(named, bones, strict=True)]
    forward = nearest_signed_permutation(np.stack([axes[:, 2], axes[:, 1], -axes[:, 0]], 1))
    dtype = skeleton.centres.dtype
    return AnatomicalFrames(
        tuple(named),
        tuple(bones),
        tuple(name for name in SEGMENTS if name not in found),
        jnp.asarray(np.array(rest).reshape(-1, 3, 3), dtype),
        jnp.asarray(forward, dtype),
    )


def find_upright(skeleton: Skeleton, motion: Motion | None) -> UprightPose:
    """Find the person in a skeleton, upright, with left and right resolved. Raises `InputError` if there is none."""
    try:
        return find_upright_pose(skeleton, identify_joints(skeleton), motion, "source")
    except UnknownSides:
        raise InputError(
            "The joint names and the toes do not determine the left and the right of the person, or contradict each "
            "other, so there are no joint angles; correct the joint names."
        ) from None
    except ValueError:
        raise InputError(
            "The person stands upright neither at rest nor in a frame of the motion, so the anatomical axes are unknown; "
            "give a motion with an upright frame."
        ) from None


def _legs_axes(upright: UprightPose) -> Axes | None:
    """Find the axes left, up and front of legs with a pelvis alone, which have no trunk to show them."""
    person, up = upright.person, upright.up
    thighs = [person.parts.get((side, "thigh")) for side in SIDES]
    if up is None or None in thighs or person.sideless:
        return None
    frame = _make_axes(up, upright.positions[thighs[1]] - upright.positions[thighs[0]])
    axes = None if frame is None else np.stack([-frame[:, 2], frame[:, 1], frame[:, 0]], 1)
    return None if toes_point_backward(person, upright.positions, axes) else axes


def _find_trunk(skeleton: Skeleton, upright: UprightPose, axes: Axes) -> dict[str, Segment]:
    """Find pelvis, thorax and head."""
    person, found = upright.person, {}
    up, right = axes[:, 1], -axes[:, 0]

    def across(part: str) -> Vector:
        pair = [person.parts.get((side, part)) for side in SIDES]
        return right if None in pair else upright.positions[pair[1]] - upright.positions[pair[0]]

    if person.pelvis >= 0:
        found["pelvis"] = person.pelvis, _make_axes(up, across("thigh"))
    arms = [person.parts[side, "upper_arm"] for side in SIDES if (side, "upper_arm") in person.parts]
    chest = [joint for joint in person.spine if skeleton.descendants[joint, arms].all()]
    if not arms:
        # models of gait have no arms, so the trunk is found by its name
        chest = [joint for joint, name in enumerate(skeleton.names) if name.lower() in TRUNK_NAMES]
    if chest:
        found["thorax"] = chest[-1], _make_axes(up, across("upper_arm"))
    if person.head >= 0:
        found["head"] = person.head, _make_axes(up, right)
    return {name: (bone, axes) for name, (bone, axes) in found.items() if axes is not None}


def _find_limbs(skeleton: Skeleton, upright: UprightPose, axes: Axes) -> dict[str, Segment]:
    """Find the segments of legs and arms."""
    found: dict[str, tuple[int, Axes | None]] = {}
    for side in SIDES:
        if upright.person.limb(side, "leg"):
            found |= {f"{name}_{side[0]}": each for name, each in _leg(skeleton, upright, axes, side).items()}
        if upright.person.limb(side, "arm"):
            found |= {f"{name}_{side[0]}": each for name, each in _arm(skeleton, upright, axes, side).items()}
    return {name: (bone, axes) for name, (bone, axes) in found.items() if axes is not None}


def _leg(
    skeleton: Skeleton, upright: UprightPose, axes: Axes, side: Side
) -> dict[str, tuple[int, Axes | None]]:
    thigh, shin, foot = upright.person.limb(side, "leg")
    at, (left, up, front) = upright.positions, axes.T
    hinge = _hinge_axis(skeleton, upright, shin)
    right = -left if hinge is None else hinge * np.sign(hinge @ -left)
    toes = far_end(skeleton, upright.person, side, "leg", foot)
    along = front if toes is None else at[toes] - at[foot]
    shank = at[shin] - at[foot]
    # across the foot and the shank, so that the foot is neither inverted nor everted; the sole is horizontal
    across = _unit(np.cross(along, shank))
    step = _make_axes(up - (up @ across) * across, across)
    return {
        "femur": (skeleton.parents[shin], _make_axes(at[thigh] - at[shin], right)),
        "tibia": (skeleton.parents[foot], _make_axes(shank, right)),
        "foot": (foot, step),
    }


def _arm(
    skeleton: Skeleton, upright: UprightPose, axes: Axes, side: Side
) -> dict[str, tuple[int, Axes | None]]:
    person, at, front = upright.person, upright.positions, axes[:, 2]
    upper, fore, hand = person.limb(side, "arm")
    arm, forearm = at[upper] - at[fore], at[fore] - at[hand]
    flexion = _elbow_axis(arm, forearm, front, _hinge_axis(skeleton, upright, fore))
    carrier, hand_bone = skeleton.parents[hand], hand
    twist = _hinge_axis(skeleton, upright, hand)
    palm = person.parts.get((side, "palm"))
    if twist is not None and palm is not None and abs(twist @ _unit(forearm)) > np.cos(MAX_TWIST_ANGLE):
        # CMU's wrist is the hinge of pronation, and its hand is the carpus
        carrier, hand_bone = hand, palm
    end = far_end(skeleton, person, side, "arm", hand)
    along = forearm if end is None or np.allclose(at[end], at[hand]) else at[hand] - at[end]
    radial = _radial_direction(person, at, side, forearm, front) * (1 if side == "right" else -1)
    return {
        "humerus": (skeleton.parents[fore], _make_axes(arm, flexion)),
        "forearm": (carrier, _make_axes(forearm, radial)),
        "hand": (hand_bone, _make_axes(along, radial)),
    }


def _elbow_axis(arm: Vector, forearm: Vector, front: Vector, hinge: Vector | None) -> Vector:
    """Find the axis about which the elbow flexes, right-handed; `arm` and `forearm` point to the trunk."""
    normal = np.cross(_unit(arm), _unit(forearm))
    forward = np.cross(front, arm)
    if hinge is not None:
        return hinge * (1.0 if hinge @ forward >= 0 else -1.0)
    # an elbow that bends backward shows no flexion
    shown = np.linalg.norm(normal) > np.sin(MIN_BEND) and normal @ forward > 0
    return normal if shown else forward


def _radial_direction(
    person: PersonJoints, at: Float[np.ndarray, "J 3"], side: Side, forearm: Vector, front: Vector
) -> Vector:
    """Find the direction from the ulna to the radius."""

    def base(finger: str) -> int | None:
        own = [
            (number, joint) for (s, f, number), joint in person.fingers.items() if (s, f) == (side, finger)
        ]
        return min(own)[1] if own else None

    index, little, thumb = base("index"), base("little"), base("thumb")
    hand = person.parts[side, "hand"]
    for first, second in ((index, little), (thumb, hand)):
        if first is not None and second is not None:
            across = at[first] - at[second]
            if np.linalg.norm(np.cross(across, _unit(forearm))) > MIN_SINE * max(
                float(np.linalg.norm(across)), 1e-6
            ):
                return across
    return front


def _hinge_axis(skeleton: Skeleton, upright: UprightPose, joint: int) -> Vector | None:
    """Compute the axis of a joint that is a hinge, in the upright pose."""
    if skeleton.kinds[joint] != "revolute":
        return None
    turn = Rotation.from_quat(upright.rotations[joint][[1, 2, 3, 0]])
    return turn.apply(np.array(skeleton.axes[joint, 0], float))


def _make_axes(y: Vector, z: Vector) -> Axes | None:
    """Make axes with an exact Y and a Z nearest to `z`; None if the two are almost parallel or have no length."""
    y = _unit(y)
    across = z - (z @ y) * y
    if np.linalg.norm(across) <= MIN_SINE * np.linalg.norm(z) or not y.any():
        return None
    z = _unit(across)
    return np.stack([np.cross(y, z), y, z], 1)


def _unit(vector: Vector) -> Vector:
    length = np.linalg.norm(vector)
    return vector / length if length > 1e-9 else np.zeros(3)
