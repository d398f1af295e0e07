"""Samples of joint rotations, with those of the joints that they are coupled to."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...arguments import checked
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ..rest_poses.anatomical_joint import AnatomicalJoint
from ..rest_poses.rest_difference import MAX_REST_ANGLE, rest_difference

#: seconds of a motion in one block that is held out: neighbouring frames are similar
BLOCK_SECONDS = 10.0
#: largest difference of the joint centres of two skeletons of one person, metres
SAME_PERSON = 1e-3


class JointSamples(NamedTuple):
    """Rotations of one joint from rest, frame by frame, and those of the joint that limits it."""

    joint: str
    kind: str
    #: unit axes of revolute and universal joints
    axes: Float[np.ndarray, "2 3"]
    rotations: Float[np.ndarray, "F 4"]
    #: samples of one block are close in time
    blocks: Int[np.ndarray, "F"]
    parent: "JointSamples | None" = None
    #: the skeleton from whose rest pose the rotations are; None where there is none
    rest: Skeleton | None = None
    #: number of the take and of the person of each sample; None where it is one
    takes: Int[np.ndarray, "F"] | None = None
    people: Int[np.ndarray, "F"] | None = None
    #: the joint of a person, with the axes of its segments; None where it is not recognised
    anatomy: AnatomicalJoint | None = None

    def take(self, frames: np.ndarray) -> "JointSamples":
        """Select some of the frames, of the parent too."""
        parent = None if self.parent is None else self.parent.take(frames)
        takes, people = (None if each is None else each[frames] for each in (self.takes, self.people))
        return self._replace(
            rotations=self.rotations[frames],
            blocks=self.blocks[frames],
            parent=parent,
            takes=takes,
            people=people,
        )


def parse_joints(text: str) -> tuple[tuple[str, str | None], ...]:
    """Parse joints with their parents, `(joint, parent)`, from text such as `LeftArm:LeftForeArm,Head`.

    A chain couples every joint to the one before it. Parents come before their children, each joint once.

    **Raises:** `InputError` where a name is empty, a joint is coupled to two parents, or the coupling has a
    cycle.
    """
    found: dict[str, str | None] = {}
    for chain in text.split(","):
        names = [name.strip() for name in chain.split(":")]
        if not all(names):
            raise InputError(f"--joints {text}: a joint's name is empty; write 'shoulder:elbow,head'.")
        for parent, joint in zip([None, *names], names, strict=False):
            if parent is not None and found.get(joint) not in (None, parent):
                raise InputError(
                    f"--joints {text}: '{joint}' is coupled to '{found[joint]}' and to '{parent}'; choose one."
                )
            found[joint] = parent or found.get(joint)
    ordered: list[str] = []
    while len(ordered) < len(found):
        ready = [n for n, p in found.items() if n not in ordered and (p is None or p in ordered)]
        if not ready:
            raise InputError(f"--joints {text}: the coupling of the joints has a cycle; leave one out.")
        ordered += ready
    return tuple((name, found[name]) for name in ordered)


@checked
def gather_samples(
    motions: Sequence[tuple[Skeleton, Motion]],
    joint: str,
    parent: str | None = None,
    names: Sequence[str] | None = None,
    people: Sequence[str] | None = None,
) -> JointSamples:
    """Collect the rotations of a joint in all frames of some motions with compatible skeletons.

    Motions of differing skeletons, or of the left and the right joint together, are collected by
    `jaxcap.biomechanics.gather_person_samples`.

    **Arguments:** `names` are the names of the motions in errors. `people` names the person of each motion; by default
    motions whose skeletons have equal joint centres are those of one person.

    **Raises:** `ValueError` where a joint is missing, does not rotate at all, or is of another kind in
    another motion, or where the rest poses of the motions differ.
    """
    if not motions:
        raise ValueError("There are no motions; give at least one.")
    above = None if parent is None else gather_samples(motions, parent, None, names, people)
    who = number_people([skeleton for skeleton, _ in motions], people)
    labels = label_motions(len(motions), names, "motion")
    kinds, rotations, blocks, start = set(), [], [], 0
    axes, rest = np.eye(3)[:2], motions[0][0]
    for number, (skeleton, motion) in enumerate(motions):
        motion_name = labels[number]
        if joint not in skeleton.names:
            raise ValueError(
                f"{motion_name}: there is no joint '{joint}'; it has {', '.join(skeleton.names)}."
            )
        j = skeleton.index(joint)
        kinds.add("ball" if skeleton.kinds[j] == "free" else skeleton.kinds[j])
        axes = np.asarray(skeleton.axes[j], float)
        check_rest_pose(rest, skeleton, joint, motion_name)
        turned = np.asarray(motion.poses.rotations[:, j], float)
        rotations.append(turned / np.linalg.norm(turned, axis=1, keepdims=True))
        blocks.append(start + (np.arange(len(turned)) / (BLOCK_SECONDS * motion.rate)).astype(int))
        start = blocks[-1][-1] + 1
    if len(kinds) > 1:
        raise ValueError(
            f"Joint '{joint}' is {' and '.join(sorted(kinds))}; learn from motions of one kind of skeleton."
        )
    kind = kinds.pop()
    if kind in ("fixed", "translate"):
        raise ValueError(f"Joint '{joint}' is {kind} and does not rotate; name a joint that rotates.")
    counts = [len(each) for each in rotations]
    return JointSamples(
        joint,
        kind,
        axes,
        np.concatenate(rotations),
        np.concatenate(blocks),
        above,
        rest,
        np.repeat(np.arange(len(counts)), counts),
        np.repeat(who, counts),
    )


def check_rest_pose(rest: Skeleton, skeleton: Skeleton, joint: str, motion_name: str) -> None:
    """Check that the segments of a joint have the directions at rest of another skeleton. Raises `ValueError`."""
    differs = rest_difference(rest, skeleton, joint)
    if differs.angle > MAX_REST_ANGLE:
        raise ValueError(
            f"{motion_name}: its rest pose is not that of the motions before, so rotations of '{joint}' have another meaning: "
            f"{differs.direction} differs by {np.degrees(differs.angle):.0f} degrees; transfer all motions to one skeleton with "
            "`jaxcap edit retarget`."
        )


def label_motions(count: int, names: Sequence[str] | None, kind: str) -> list[str]:
    """Return the names of motions in errors, by default numbers. Raises `InputError` where there is not one for each."""
    if names is None:
        return [f"{kind} {number + 1}" for number in range(count)]
    if len(names) != count:
        raise InputError(f"There are {len(names)} names for {count} {kind}s; give one for each.")
    return list(names)


def number_people(skeletons: Sequence[Skeleton], people: Sequence[str] | None) -> Int[np.ndarray, "M"]:
    """Number the people of some motions by their names, else by the joint centres of their skeletons.

    **Raises:** `InputError` where there is not one name for each motion.
    """
    if people is not None:
        return number_names(people, len(skeletons))
    seen: list[np.ndarray] = []
    numbers = []
    for skeleton in skeletons:
        centres = np.asarray(skeleton.centres, float)
        same = [
            number
            for number, each in enumerate(seen)
            if each.shape == centres.shape and np.allclose(each, centres, atol=SAME_PERSON)
        ]
        numbers.append(same[0] if same else len(seen))
        if not same:
            seen.append(centres)
    return np.array(numbers, int)


def number_names(people: Sequence[str], count: int) -> Int[np.ndarray, "M"]:
    """Number the people of some motions by their names. Raises `InputError` where there is not one for each motion."""
    if len(people) != count:
        raise InputError(
            f"There are {len(people)} names of people for {count} motions; give one for each motion."
        )
    return np.unique(np.array(people, str), return_inverse=True)[1]


def angular_range(rotations: Float[np.ndarray, "F 4"]) -> float:
    """Estimate the angular range of rotations, radians.

    It is the largest angle between any rotation and the one that is farthest from the first.
    """
    end = rotations[np.argmin(np.abs(rotations @ rotations[0]))]
    return float(2 * np.arccos(np.clip(np.abs(rotations @ end).min(), 0.0, 1.0)))
