"""Samples of joint rotations from tables of joint angles, by which limits are learned without a skeleton."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ..arguments import checked
from ..errors import InputError
from ..limits.learning.samples import BLOCK_SECONDS, JointSamples, label_motions, number_names
from ..limits.rest_poses.anatomical_joint import AnatomicalJoint, convert_rotations
from .anatomical_joints import JOINT_NAMES, joint_segments
from .angles import JointAngles
from .conventions import AngleConvention


@checked
def gather_angle_samples(
    angles: Sequence[JointAngles],
    joint: str,
    parent: str | None = None,
    names: Sequence[str] | None = None,
    people: Sequence[str] | None = None,
    both_sides: bool = False,
) -> JointSamples:
    """Collect the rotations of an anatomical joint, such as `knee_r`, and of its parent, from tables of joint angles.

    The rest pose of these samples is the anatomical position, so limits from them apply to every skeleton of a person.
    Angles of a joint that a table does not have are zero: a knee with one angle is a hinge.

    **Arguments:** `angles` of motions, with a rate. `names` are the tables' names in errors, and `people` the person of
    each, by default one for all. `both_sides` adds the mirrored rotations of the other side.

    **Raises:** `InputError` where the joint is no anatomical name, a table has none of its angles or no frames, or the names are
    not as many as the tables.
    """
    if not angles:
        raise InputError("There are no tables of joint angles; give at least one.")
    labels = label_motions(len(angles), names, "table")
    who = np.zeros(len(angles), int) if people is None else number_names(people, len(angles))
    target = _anatomical_position(joint)
    rotations, blocks, takes, persons, start = [], [], [], [], 0
    for number, table in enumerate(angles):
        if table.rate is None or table.values.ndim != 2:
            raise InputError(
                f"{labels[number]}: these are the angles of a single pose; give those of a motion."
            )
        if not len(table.values):
            raise InputError(f"{labels[number]}: the table has no frames; give angles of a motion.")
        for place in (joint, target.other_side) if both_sides else (joint,):
            matrices = segment_rotations(table, place, labels[number])
            if place != joint:
                matrices = convert_rotations(matrices, _anatomical_position(place), target)
            rotations.append(Rotation.from_matrix(matrices).as_quat(scalar_first=True))
            count = len(matrices)
            blocks.append(start + (np.arange(count) / (BLOCK_SECONDS * table.rate)).astype(int))
            takes.append(np.full(count, number))
            persons.append(np.full(count, who[number]))
        start = int(blocks[-1][-1]) + 1
    above = None if parent is None else gather_angle_samples(angles, parent, None, names, people, both_sides)
    return JointSamples(
        joint,
        "ball",
        np.eye(3)[:2],
        np.concatenate(rotations),
        np.concatenate(blocks),
        above,
        takes=np.concatenate(takes),
        people=np.concatenate(persons),
        anatomy=target,
    )


@checked
def segment_rotations(
    angles: JointAngles, joint: str, label: str = "the table"
) -> Float[np.ndarray, "F 3 3"]:
    """Compute the rotations of the distal segment of a joint relative to the proximal one, between anatomical axes.

    **Raises:** `InputError` where there is none of the joint's angles.
    """
    proximal, distal = joint_segments(joint)
    own = [
        (column, each)
        for column, each in enumerate(angles.conventions)
        if (each.proximal, each.distal) == (proximal, distal)
    ]
    if not own:
        there = [name for name in JOINT_NAMES if _has_angles(angles.conventions, name)]
        raise InputError(
            f"{label}: there are no angles of '{joint}'; there are those of {', '.join(there) or 'no joint of a limb'}."
        )
    # the order with the most angles; of equal ones, the first
    orders = [each.order for _, each in own]
    order = max(dict.fromkeys(orders), key=orders.count)
    values = np.asarray(angles.values, float)
    if angles.unit == "deg":
        values = np.radians(values)
    three = np.zeros((len(values), 3))
    for column, each in own:
        if each.order == order:
            three[:, each.position] = each.sign * values[:, column]
    matrices = Rotation.from_euler(order.upper(), three).as_matrix()
    if joint.endswith("_l"):
        # angles of the left side are those of the mirror image
        mirror = np.diag([1.0, 1.0, -1.0])
        matrices = mirror @ matrices @ mirror
    return matrices


def _has_angles(conventions: Sequence[AngleConvention], joint: str) -> bool:
    return any((each.proximal, each.distal) == joint_segments(joint) for each in conventions)


def _anatomical_position(joint: str) -> AnatomicalJoint:
    if joint not in JOINT_NAMES:
        raise InputError(f"'{joint}' is no anatomical joint; tables of angles have {', '.join(JOINT_NAMES)}.")
    return AnatomicalJoint(joint, joint, jnp.eye(3), jnp.eye(3))
