"""A skeleton and its motion from raw markers, limb by limb (Silaghi et al. 1998, local technique)."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ..arguments import checked
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..observe.marker_labels import label_stem
from ..observe.markers import MarkerFrames
from .rotation_centres.estimate_joint import CentreMethod
from .rotation_centres.joint import Joint
from .segments.borrowed_markers import borrow_markers
from .segments.computed_points import find_computed_points
from .segments.find_segments import apply_corrections
from .segments.gaps import is_static
from .segments.segment_sets import Segments
from .segments.swaps import correct_swaps
from .skeleton.assemble import AssembledSkeleton, assemble_skeleton, segment_poses
from .skeleton.find_bones import find_bones
from .skeleton.lengths import LengthMethod, estimate_bone_lengths, joint_trajectories, list_bones
from .skeleton.segment_tree import SegmentTree, find_segment_tree, template_pairs
from .subject import Subject, make_subject

#: a joint is reported as hardly rotating where its swept angle is below this, radians
MIN_SWEPT_ANGLE = np.radians(15.0)
#: or where the standard deviation of its centre, across the axis of a hinge, is above this, metres
MAX_CENTRE_DEVIATION = 0.03
#: above this, metres, the data do not show that the two segments are joined
UNCONNECTED_DEVIATION = 0.5
#: a point without a label has to be visible in this share of the frames
MIN_VISIBLE_SHARE = 0.2


class LocalFit(NamedTuple):
    """The result of the local technique. `messages` lists in sentences what the data do not determine."""

    segments: Segments
    #: joint of each segment with its parent, None at roots
    joints: tuple[Joint | None, ...]
    #: the tree of segments and their frames
    tree: SegmentTree
    skeleton: Skeleton
    motion: Motion
    #: (M,) bone of each marker, -1 where it is on no bone
    bones: Int[np.ndarray, "M"]
    #: (M, 3) position of each marker in the world at rest, metres
    offsets: Float[np.ndarray, "M 3"]
    #: the skeleton with the markers that are on its bones
    subject: Subject
    #: the markers after swapped labels were corrected
    markers: MarkerFrames
    messages: tuple[str, ...]


@checked
def fit_local(
    frames: MarkerFrames,
    segments: Segments | None = None,
    threshold: float | None = None,
    method: CentreMethod = "score",
    template: tuple[Skeleton, Mapping[str, str]] | None = None,
    symmetry: Sequence[tuple[str, str]] | None = None,
    *,
    corrections: Mapping[str, tuple[str, float]] | None = None,
    lengths: LengthMethod = "global",
) -> LocalFit:
    """Estimate segments, joints, skeleton and motion from raw markers without a marker placement.

    **Arguments:** `segments` where known, otherwise they are found, with `threshold` metres if given and a
    user's `corrections` (marker -> (segment, weight)); `method` of the centres of rotation; `template` a
    skeleton and a map from segment names to names of its bones, otherwise the tree is found; `symmetry`
    pairs of segments with bones of equal length; `lengths` the method for bone lengths.

    **Raises:** `ValueError` where no markers are visible, nothing moves, no markers move together, or no
    segment has three markers that are visible together.
    """
    positions, seen = np.asarray(frames.positions, float), np.asarray(frames.visible)
    labels, messages = frames.labels, []
    if not seen.any():
        raise ValueError("No marker is visible in any frame, so there is nothing to fit.")
    if is_static(frames):
        raise ValueError(
            f"All {len(frames)} frames are equal: nothing moves, so neither segments nor joints can be "
            "determined. Give a take in which every joint rotates."
        )
    ever = np.asarray(seen.any(0)).tolist()
    lost = [label for label, some in zip(labels, ever, strict=True) if not some]
    if lost:
        messages.append(f"{_format_names(lost)} never visible and left out.")
    mended = correct_swaps(positions, seen, labels)
    messages += mended.messages
    positions, seen = mended.positions, mended.seen
    placed = _placed_markers(segments, corrections, labels)
    left_out, reasons = _leave_out_points(positions, seen, labels, placed)
    shown = seen & ~left_out
    if segments is None:
        segments = find_bones(positions, shown, threshold)
    if corrections:
        segments = apply_corrections(segments, labels, corrections)
    pairs = None if template is None else template_pairs(template[0], segments, template[1])
    tree = find_segment_tree(*borrow_markers(positions, shown, segments), method, pairs)
    if not tree.augmented.frames.known.any():
        raise ValueError(
            "No segment has three markers that are visible together and not on a line, so none has a frame; "
            "give a larger threshold or a take with fewer gaps."
        )
    root = max(tree.roots, key=lambda k: _count_markers(tree, k, segments))
    if segments.num_segments == 1:
        messages.append(
            "All distances between markers are constant, so the markers form one segment without a joint. "
            "For joints, give a take in which every joint rotates."
        )
    assembled = assemble_skeleton(
        tree, root, len(labels), _bone_length_map(tree, lengths, symmetry, segments)
    )
    loose = [labels[m] for m in np.flatnonzero(segments.is_loose & seen.any(0) & ~left_out)]
    messages = [
        *_describe_omitted(tree, assembled, segments, labels),
        *_describe_loose(loose),
        *reasons,
        *messages,
        *_describe_joints(tree, assembled, segments),
    ]
    subject = _attach_markers(assembled, segments, labels, frames.positions.dtype)
    poses = segment_poses(assembled, tree)
    return LocalFit(
        segments,
        tree.joints,
        tree,
        subject.skeleton,
        Motion(poses, frames.rate),
        assembled.bones,
        assembled.offsets,
        subject,
        MarkerFrames(jnp.asarray(positions, frames.positions.dtype), jnp.asarray(seen), labels, frames.rate),
        tuple(messages),
    )


def _bone_length_map(
    tree: SegmentTree, method: LengthMethod, symmetry, segments: Segments
) -> dict[tuple[int, int], float]:
    between = list_bones(tree)
    same = []
    for left, right in symmetry or ():
        for name in (left, right):
            if name not in segments.names:
                raise ValueError(
                    f"There is no segment '{name}'; expected one of {', '.join(segments.names)}."
                )
        ends = [
            [n for n, bone in enumerate(between) if bone[0] == segments.names.index(name)]
            for name in (left, right)
        ]
        if len(ends[0]) == len(ends[1]) == 1:
            same.append((ends[0][0], ends[1][0]))
    positions, known = joint_trajectories(tree)
    deviations = np.array([1.0 if joint is None else max(joint.residual, 1e-4) for joint in tree.joints])
    found = estimate_bone_lengths(
        positions, known, between, method, left_right_pairs=same, deviations=deviations
    )
    return dict(zip(between, found.tolist(), strict=True))


def _attach_markers(
    assembled: AssembledSkeleton, segments: Segments, labels: tuple[str, ...], dtype
) -> Subject:
    on = np.flatnonzero(assembled.bones >= 0)
    return make_subject(
        assembled.skeleton,
        np.maximum(assembled.bones, 0),
        np.where(
            (assembled.bones >= 0)[:, None], assembled.offsets, np.asarray(assembled.skeleton.centres)[0]
        ),
        labels,
        weights=np.where(np.isin(np.arange(len(labels)), on), segments.weights, 0.0),
    )


def _count_markers(tree: SegmentTree, root: int, segments: Segments) -> int:
    total = len(segments.members[root])
    return total + sum(
        _count_markers(tree, k, segments) for k, parent in enumerate(tree.parents) if parent == root
    )


def _placed_markers(
    segments: Segments | None, corrections: Mapping[str, tuple[str, float]] | None, labels: tuple[str, ...]
) -> Bool[np.ndarray, "M"]:
    """Find the markers that the user places on a segment."""
    placed = np.zeros(len(labels), bool) if segments is None else ~segments.is_loose
    for label, (name, weight) in (corrections or {}).items():
        if label in labels:
            placed[labels.index(label)] = name != "-" and weight > 0
    return placed


def _leave_out_points(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    labels: tuple[str, ...],
    placed: Bool[np.ndarray, "M"],
) -> tuple[Bool[np.ndarray, "M"], list[str]]:
    """Find points that are no markers, or too short pieces of some, and that the user does not place; return a mask and messages."""
    left_out, messages = np.zeros(len(labels), bool), []
    short = [
        m
        for m, label in enumerate(labels)
        if not placed[m] and not label_stem(label) and 0 < seen[:, m].mean() < MIN_VISIBLE_SHARE
    ]
    if short:
        left_out[short] = True
        names = [labels[m] for m in short]
        messages.append(
            f"{_format_names(names)} without a label and visible in less than {100 * MIN_VISIBLE_SHARE:.0f} % of the frames, and left "
            "out. If they are pieces of markers, join them."
        )
    for point in find_computed_points(positions, seen & ~left_out):
        if placed[point.marker]:
            continue
        left_out[point.marker] = True
        sources = ", ".join(f"'{labels[m]}'" for m in point.sources)
        messages.append(f"'{labels[point.marker]}' is computed from {sources}, and left out.")
    return left_out, messages


def _describe_loose(loose: Sequence[str]) -> list[str]:
    if not loose:
        return []
    return [f"{_format_names(loose)} on no bone: no segment has a constant distance from {_pronoun(loose)}."]


def _describe_omitted(
    tree: SegmentTree, assembled: AssembledSkeleton, segments: Segments, labels
) -> list[str]:
    """Describe the segments that have no bone, those that are joined to each other together."""
    known = np.asarray(tree.augmented.frames.known.any(0))
    messages = []
    for root in tree.roots:
        inside = [k for k in range(segments.num_segments) if _root_of(tree, k) == root]
        inside = [k for k in inside if k not in assembled.bone_segments]
        markers = [labels[m] for k in inside for m in segments.members[k]]
        if not markers:
            continue
        if known[root] and root not in assembled.bone_segments:
            messages.append(
                f"{_format_names(markers)} not connected to the other markers: they do not move together with them, "
                "as if they were on another subject. They are left out; fit them separately."
            )
        else:
            messages.append(
                f"{_format_names(markers)} on no bone: in no frame do they determine the rotation of a bone."
            )
    return messages


def _describe_joints(tree: SegmentTree, assembled: AssembledSkeleton, segments: Segments) -> list[str]:
    messages = []
    for segment in assembled.bone_segments:
        joint = tree.joints[segment]
        if joint is None:
            continue
        across = joint.deviations[-2 if joint.axis_in_parent is not None else -1]
        if joint.swept_angle < MIN_SWEPT_ANGLE or across > MAX_CENTRE_DEVIATION:
            messages.append(
                f"The joint between '{segments.names[joint.parent]}' and '{segments.names[segment]}' "
                f"rotates by {np.degrees(joint.swept_angle):.0f} degrees, and its centre has a standard deviation "
                f"of {1e3 * across:.0f} mm in the worst "
                f"direction{' perpendicular to its axis' if joint.axis_in_parent is not None else ''}; "
                + (
                    "the data do not show that the segments are connected. If they belong to two bodies, "
                    "fit each body separately."
                    if across > UNCONNECTED_DEVIATION
                    else "in undetermined directions it is midway between the nearest markers."
                )
            )
    return messages


def _root_of(tree: SegmentTree, segment: int) -> int:
    while tree.parents[segment] >= 0:
        segment = tree.parents[segment]
    return segment


def _format_names(names: Sequence[str]) -> str:
    """Format names with their verb: "'A', 'B' are"."""
    shown = ", ".join(f"'{name}'" for name in names[:12]) + (", ..." if len(names) > 12 else "")
    return f"{shown} {'is' if len(names) == 1 else 'are'}"


def _pronoun(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"
