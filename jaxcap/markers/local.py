"""A skeleton and its motion from raw markers, limb by limb (Silaghi et al. 1998, local technique)."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..arguments import checked
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..observe import MarkerFrames
from .rotation_centres.centres import Method
from .rotation_centres.joint import Joint
from .segments.gaps import is_still
from .segments.partition import correct, find_partition
from .segments.segment import Segments
from .segments.swaps import mend_swaps
from .skeleton.assemble import Assembled, assemble, pose_segments
from .skeleton.lengths import LengthMethod, bone_lengths, bones, joint_places
from .skeleton.tree import Tree, find_tree, template_pairs
from .subject import Subject, make_subject

#: a joint is reported as hardly rotating where its swept angle is below this, radians
HARDLY = np.radians(15.0)
#: or where the standard deviation of its centre, across the axis of a hinge, is above this, metres
VAGUE = 0.03
#: above this, metres, the data do not show that the two segments are joined
APART = 0.5


class LocalFit(NamedTuple):
    """The result of the local technique. `told` lists in sentences what the data do not determine."""

    segments: Segments
    #: joint of each segment with its parent, None at roots
    joints: tuple[Joint | None, ...]
    #: the tree of segments and their frames
    tree: Tree
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
    told: tuple[str, ...]


@checked
def fit_local(
    frames: MarkerFrames,
    segments: Segments | None = None,
    threshold: float | None = None,
    method: Method = "score",
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
    places, seen = np.asarray(frames.places, float), np.asarray(frames.seen)
    labels, told = frames.labels, []
    if not seen.any():
        raise ValueError("No marker is visible in any frame, so there is nothing to fit.")
    if is_still(frames):
        raise ValueError(
            f"All {len(frames)} frames are equal: nothing moves, so neither segments nor joints can be "
            "determined. Give a take in which every joint rotates."
        )
    ever = np.asarray(seen.any(0)).tolist()
    lost = [label for label, some in zip(labels, ever, strict=True) if not some]
    if lost:
        told.append(f"{_listed(lost)} never visible and left out.")
    mended = mend_swaps(places, seen, labels)
    told += mended.told
    places, seen = mended.places, mended.seen
    if segments is None:
        segments = find_partition(places, seen, threshold).segments
    if corrections:
        segments = correct(segments, labels, corrections)
    loose = [labels[m] for m in np.flatnonzero(segments.loose) if labels[m] not in lost]
    if loose:
        told.append(
            f"{_listed(loose)} in no segment: no segment has a constant distance from {_them(loose)}."
        )
    pairs = None if template is None else template_pairs(template[0], segments, template[1])
    tree = find_tree(places, seen, segments, method, pairs)
    if not tree.markers.frames.known.any():
        raise ValueError(
            "No segment has three markers that are visible together and not on a line, so none has a frame; "
            "give a larger threshold or a take with fewer gaps."
        )
    root = max(tree.roots, key=lambda k: _size(tree, k, segments))
    told += _pieces(tree, root, segments, labels)
    if segments.num_segments == 1:
        told.append(
            "All distances between markers are constant, so the markers form one segment without a joint. "
            "For joints, give a take in which every joint rotates."
        )
    made = assemble(tree, root, len(labels), _lengths(tree, lengths, symmetry, segments))
    told += _precisions(tree, made, segments)
    told += _left_out(tree, made, segments, labels)
    subject = _subject(made, segments, labels, frames.places.dtype)
    poses = pose_segments(made, tree)
    return LocalFit(
        segments,
        tree.joints,
        tree,
        subject.skeleton,
        Motion(poses, frames.rate),
        made.bones,
        made.offsets,
        subject,
        MarkerFrames(jnp.asarray(places, frames.places.dtype), jnp.asarray(seen), labels, frames.rate),
        tuple(told),
    )


def _lengths(tree: Tree, method: LengthMethod, symmetry, segments: Segments) -> dict[tuple[int, int], float]:
    between = bones(tree)
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
    places, known = joint_places(tree)
    deviations = np.array([1.0 if joint is None else max(joint.residual, 1e-4) for joint in tree.joints])
    found = bone_lengths(places, known, between, method, same=same, deviations=deviations)
    return dict(zip(between, found.tolist(), strict=True))


def _subject(made: Assembled, segments: Segments, labels: tuple[str, ...], dtype) -> Subject:
    on = np.flatnonzero(made.bones >= 0)
    return make_subject(
        made.skeleton,
        np.maximum(made.bones, 0),
        np.where((made.bones >= 0)[:, None], made.offsets, np.asarray(made.skeleton.centres)[0]),
        labels,
        weights=np.where(np.isin(np.arange(len(labels)), on), segments.weights, 0.0),
    )


def _size(tree: Tree, root: int, segments: Segments) -> int:
    total = len(segments.members[root])
    return total + sum(_size(tree, k, segments) for k, parent in enumerate(tree.parents) if parent == root)


def _pieces(tree: Tree, root: int, segments: Segments, labels) -> list[str]:
    others = [k for k in tree.roots if k != root]
    told = []
    for other in others:
        inside = [other]
        for k in inside:
            inside += [c for c, parent in enumerate(tree.parents) if parent == k]
        markers = [labels[m] for k in inside for m in segments.members[k]]
        told.append(
            f"{_listed(markers)} not connected to the other markers: they do not move together with them, "
            "as if they were on another subject. They are left out; fit them separately."
        )
    return told


def _precisions(tree: Tree, made: Assembled, segments: Segments) -> list[str]:
    told = []
    for segment in made.order:
        joint = tree.joints[segment]
        if joint is None:
            continue
        across = joint.precision[-2 if joint.axis_in_parent is not None else -1]
        if joint.swept < HARDLY or across > VAGUE:
            told.append(
                f"The joint between '{segments.names[joint.parent]}' and '{segments.names[segment]}' "
                f"rotates by {np.degrees(joint.swept):.0f} degrees, and its centre has a standard deviation "
                f"of {1e3 * across:.0f} mm in the worst "
                f"direction{' perpendicular to its axis' if joint.axis_in_parent is not None else ''}; "
                + (
                    "the data do not show that the segments are connected. If they belong to two bodies, "
                    "fit each body separately."
                    if across > APART
                    else "in undetermined directions it is midway between the nearest markers."
                )
            )
    return told


def _left_out(tree: Tree, made: Assembled, segments: Segments, labels) -> list[str]:
    joined = {k for k, parent in enumerate(tree.parents) if parent >= 0} | set(tree.roots)
    roots = [k for k in tree.roots if k not in made.order]
    told = []
    for k, name in enumerate(segments.names):
        if k in made.order or k not in joined or k in roots or _top(tree, k) != made.order[0]:
            continue
        markers = [labels[m] for m in segments.members[k]]
        told.append(f"The segment '{name}' ({_listed(markers)} in it) has no frame and no bone.")
    return told


def _top(tree: Tree, segment: int) -> int:
    while tree.parents[segment] >= 0:
        segment = tree.parents[segment]
    return segment


def _listed(names: Sequence[str]) -> str:
    """Format names with their verb: "'A', 'B' are"."""
    shown = ", ".join(f"'{name}'" for name in names[:12]) + (", ..." if len(names) > 12 else "")
    return f"{shown} {'is' if len(names) == 1 else 'are'}"


def _them(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"
