"""Samples of a person's joint from motions of differing skeletons, and of the left and the right joint together."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ..arguments import checked
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..errors import InputError
from ..limits.learning.samples import (
    JointSamples,
    check_rest_pose,
    gather_samples,
    label_motions,
    number_people,
)
from ..limits.rest_poses.anatomical_joint import AnatomicalJoint, convert_rotations
from ..limits.rest_poses.rest_difference import has_equal_rest
from .anatomical_joints import find_anatomical_joints

Anatomy = Mapping[str, AnatomicalJoint]


@checked
def gather_person_samples(
    motions: Sequence[tuple[Skeleton, Motion]],
    joint: str,
    parent: str | None = None,
    names: Sequence[str] | None = None,
    people: Sequence[str] | None = None,
    both_sides: bool = False,
) -> JointSamples:
    """Collect the rotations of a joint, and of its parent, in all frames of some motions of people.

    Skeletons may differ in joint names and rest poses: rotations are converted to the rest pose of the first skeleton that
    has the joint, by the anatomical axes of the segments (`find_anatomical_joints`). Skeletons without a recognised person
    need the same joint names and rest pose.

    **Arguments:** `joint` and `parent` are names of joints in the first skeleton that has them, or anatomical names such as
    `knee_r`. `names` and `people` as in `gather_samples`. `both_sides` adds the mirrored rotations of the same joint of
    the other side.

    **Raises:** `InputError` or `ValueError` as `gather_samples`; `InputError` where `both_sides` needs a joint that is not
    recognised on one side of one of the skeletons, or the names are not as many as the motions.
    """
    anatomies = [_anatomy(skeleton, motion) for skeleton, motion in motions]
    who = number_people([skeleton for skeleton, _ in motions], people)
    labels = label_motions(len(motions), names, "motion")

    def gather(name: str, above: str | None) -> JointSamples:
        over = None if above is None else gather(above, None)
        reference, name = _reference(motions, anatomies, name)
        target = _named(anatomies[reference], name)
        if both_sides and target is None:
            raise InputError(
                f"{labels[reference]}: '{name}' is no recognised hip, knee, ankle, shoulder, elbow or wrist, so the other side is "
                "unknown; leave out --both-sides."
            )
        pieces: list[JointSamples] = []
        start = 0
        for number, each in enumerate(motions):
            wanted = [name if target is None else target.name]
            if both_sides and target is not None:
                _check_sides(anatomies[number], target, labels[number])
                wanted.append(target.other_side)
            for place in wanted:
                found = _gather_one(
                    each, labels[number], name, place, target, anatomies[number], motions[reference][0]
                )
                count = len(found.rotations)
                pieces.append(
                    found._replace(
                        blocks=found.blocks + start,
                        takes=np.full(count, number),
                        people=np.full(count, who[number]),
                    )
                )
            start = int(pieces[-1].blocks[-1]) + 1
        skeleton = motions[reference][0]
        return _join(pieces, name, target)._replace(
            parent=over,
            rest=skeleton,
            axes=np.asarray(skeleton.axes[skeleton.index(name)], float),
        )

    return gather(joint, parent)


def _gather_one(
    motion: tuple[Skeleton, Motion],
    label: str,
    name: str,
    place: str,
    target: AnatomicalJoint | None,
    anatomy: Anatomy,
    reference: Skeleton,
) -> JointSamples:
    """Collect the samples of one motion, in the rest pose of the reference skeleton."""
    skeleton = motion[0]
    source = anatomy.get(place)
    if target is not None and source is not None:
        own = gather_samples([motion], source.joint, None, [label])
        if source.joint == name and has_equal_rest(reference, skeleton, name):
            return own
        turned = Rotation.from_quat(own.rotations, scalar_first=True).as_matrix()
        turned = Rotation.from_matrix(convert_rotations(turned, source, target))
        return own._replace(rotations=turned.as_quat(scalar_first=True))
    own = gather_samples([motion], name, None, [label])
    check_rest_pose(reference, skeleton, name, label)
    return own


def _check_sides(anatomy: Anatomy, target: AnatomicalJoint, label: str) -> None:
    """Check that a joint is recognised on both sides, so that it has as many samples as its parent. Raises `InputError`."""
    missing = [name for name in (target.name, target.other_side) if name not in anatomy]
    if missing:
        raise InputError(
            f"{label}: there is no joint that is recognised as '{missing[0]}', for example because its segment has twist joints, so "
            "the sides cannot be learned together; leave out --both-sides, or this motion."
        )


def _join(pieces: list[JointSamples], name: str, target: AnatomicalJoint | None) -> JointSamples:
    """Concatenate the samples of motions; a recognised joint of several kinds rotates freely."""
    first = pieces[0]
    kinds = sorted({each.kind for each in pieces})
    if target is None and len(kinds) > 1:
        raise InputError(
            f"Joint '{name}' is {' and '.join(kinds)}; learn from motions of one kind of skeleton."
        )
    groups = [
        np.concatenate([each for each in column if each is not None])
        for column in zip(*((p.rotations, p.blocks, p.takes, p.people) for p in pieces), strict=True)
    ]
    return first._replace(
        joint=name,
        kind=first.kind if len(kinds) == 1 else "ball",
        rotations=groups[0],
        blocks=groups[1],
        takes=groups[2],
        people=groups[3],
        anatomy=target,
    )


def _anatomy(skeleton: Skeleton, motion: Motion) -> Anatomy:
    try:
        return find_anatomical_joints(skeleton, motion)
    except InputError:
        return {}


def _reference(motions, anatomies: Sequence[Anatomy], name: str) -> tuple[int, str]:
    """Find the first motion whose skeleton has a joint, and the joint's name there."""
    for number, (skeleton, _) in enumerate(motions):
        if name in skeleton.names:
            return number, name
        if name in anatomies[number]:
            return number, anatomies[number][name].joint
    # the error of a missing joint
    gather_samples(motions[:1], name)
    raise AssertionError(name)


def _named(anatomy: Anatomy, name: str) -> AnatomicalJoint | None:
    return next((each for each in anatomy.values() if each.joint == name), None)
