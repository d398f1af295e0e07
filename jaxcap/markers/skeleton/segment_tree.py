"""The tree of segments: a minimum spanning tree by the cost of the joints, or the tree of a template."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...body.skeleton import Skeleton
from ...geometry.spanning_tree import spanning_tree
from ..rotation_centres.estimate_joint import CentreMethod, find_joint
from ..rotation_centres.hinge_centres import align_hinge_centres
from ..rotation_centres.joint import Joint
from ..segments.relative_motion import RelativeMotion, relative_motion
from ..segments.segment_frames import fit_segment_frames
from ..segments.segment_sets import Segments
from ..segments.virtual_markers import AugmentedMarkers, add_virtual_markers, assume_hinge

#: cost per metre between a centre and the nearest marker of either segment, against a metre of residual: two
#: segments that hardly rotate against each other share any centre, joined ones have it near their markers
DISTANCE_COST = 0.03
#: a joint is rejected where its cost is above this share of the markers' median distance, and above this
#: multiple of the median joint's cost: the segments are then of different bodies
MAX_RELATIVE_COST, MAX_COST_RATIO = 0.25, 3.0
#: segments with few markers get their frames in rounds, each with the joints of at most this multiple of the
#: round's lowest cost
ROUND_COST_RATIO = 2.0


#: joint and cost, metres, of each pair of segments that was examined, the smaller index first
CandidateJoints = dict[tuple[int, int], tuple[Joint, float]]


class SegmentTree(NamedTuple):
    """Segments joined to a tree, or to a forest where some are not connected."""

    #: parent of each segment, -1 at roots
    parents: tuple[int, ...]
    #: joint of each segment with its parent, None at roots
    joints: tuple[Joint | None, ...]
    #: cost of each joint, metres; zero at roots
    costs: Float[np.ndarray, "K"]
    #: markers and virtual markers at joints, with the frames of all segments
    augmented: AugmentedMarkers

    @property
    def roots(self) -> tuple[int, ...]:
        """The roots in the order of the segments."""
        return tuple(k for k, parent in enumerate(self.parents) if parent < 0)


def find_segment_tree(
    positions: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
    segments: Segments,
    method: CentreMethod = "score",
    pairs: list[tuple[int, int]] | None = None,
) -> SegmentTree:
    """Find the minimum spanning tree over the costs of joints between segments (Kirk, O'Brien, Forsyth 2005).

    The cost of a joint is its residual plus a share of its distances from the markers of both segments.
    Segments with fewer than three markers are joined first, by spheres of their markers about another
    segment. Such a joint becomes a virtual marker, so that the segment gets a frame and can carry others.
    Where the markers are still on a line, a hinge is assumed, as in the paper. The root is the segment that
    balances the markers around it.

    **Arguments:** `pairs` of joined segments, where known (`template_pairs`).
    """
    frames = fit_segment_frames(positions, seen, segments)
    now = AugmentedMarkers(positions, seen, segments, frames)
    found: CandidateJoints = {}
    used: CandidateJoints = {}
    for _ in range(2 * segments.num_segments):
        _find_missing_joints(now, found, used, pairs, "score")
        bare = _segments_without_frame(now)
        links: dict[int, Joint] = {}
        open_ = [
            p
            for p in _cheapest_pairs(found, segments.num_segments)
            if found[p][0].child in bare and p not in used
        ]
        # a distant neighbour may be the nearest one with a frame so far: the lowest costs first
        most = ROUND_COST_RATIO * min((found[pair][1] for pair in open_), default=0.0)
        for pair in open_:
            joint = found[pair][0]
            if found[pair][1] <= most and joint.child not in links:
                links[joint.child] = joint
                used[pair] = found[pair]
        if not links:
            break
        now = add_virtual_markers(now.positions, now.seen, now.segments, now.frames, list(links.items()))
        settled = bare - _segments_without_frame(now)
        found = {pair: some for pair, some in found.items() if not settled & set(pair)}
    for segment in sorted(_segments_without_frame(now)):
        base = [pair for pair in _cheapest_pairs(found, segments.num_segments) if segment in pair]
        if base and len(segments.members[segment]) >= 2:
            now = assume_hinge(now, segment, found[base[0]][0].parent)
            found = {pair: some for pair, some in found.items() if segment not in pair}
            _find_missing_joints(now, found, used, pairs, "score")
    if method != "score":
        kept, found = _cheapest_pairs(found, segments.num_segments), {}
        _find_missing_joints(now, found, used, kept, method)
    # a segment without a frame would cut off all that is joined through it
    bare = _segments_without_frame(now)
    found = {pair: some for pair, some in found.items() if not bare & set(pair)}
    chosen = _cheapest_pairs(found, segments.num_segments)
    limit = MAX_RELATIVE_COST * median_distance(positions, seen)
    usual = float(np.median([found[pair][1] for pair in chosen])) if chosen else 0.0
    accepted = [pair for pair in chosen if found[pair][1] <= max(limit, MAX_COST_RATIO * usual)]
    return _root_tree(now, accepted, found)


def template_pairs(template: Skeleton, segments: Segments, bones: Mapping[str, str]) -> list[tuple[int, int]]:
    """List the pairs of segments that a template joins: each with its nearest ancestor that has markers.

    **Arguments:** `bones` maps names of segments to names of the template's joints.

    **Raises:** `ValueError` for a segment or joint that does not exist, or two segments on one bone.
    """
    owner: dict[int, int] = {}
    for name, bone in bones.items():
        if name not in segments.names:
            raise ValueError(f"There is no segment '{name}'; expected one of {', '.join(segments.names)}.")
        if bone not in template.names:
            raise ValueError(
                f"The template has no joint '{bone}'; expected one of {', '.join(template.names)}."
            )
        if template.index(bone) in owner:
            other = segments.names[owner[template.index(bone)]]
            raise ValueError(
                f"The segments '{other}' and '{name}' are both on the bone '{bone}'; give each its own bone."
            )
        owner[template.index(bone)] = segments.names.index(name)
    pairs = []
    for bone, segment in owner.items():
        above = template.parents[bone]
        while above >= 0 and above not in owner:
            above = template.parents[above]
        if above >= 0:
            pairs.append((owner[above], segment))
    return pairs


def joint_cost(joint: Joint, motion: RelativeMotion) -> float:
    """Compute the cost of a joint, metres: its residual and a share of its distances from the markers."""
    to_base = np.linalg.norm(motion.parent_markers - joint.in_parent, axis=1).min()
    tracks = [motion.child_markers[s, n] for n, s in enumerate(motion.child_visible.T)]
    to_child = min(float(np.median(np.linalg.norm(track - joint.in_parent, axis=1))) for track in tracks)
    return joint.residual + DISTANCE_COST * (float(to_base) + to_child)


def _find_missing_joints(
    augmented: AugmentedMarkers, found: CandidateJoints, used: CandidateJoints, pairs, method: CentreMethod
) -> None:
    """Find the joints that are still missing.

    A joint that gave a segment its frame (`used`) is no evidence for itself. It keeps its position, its
    precision and its cost.
    """
    noise = augmented.frames.noise(augmented.positions, augmented.seen, augmented.segments)
    known = np.asarray(augmented.frames.known.any(0))
    count = augmented.segments.num_segments
    size = [
        float(np.sum(augmented.frames.local_positions[list(some)] ** 2))
        for some in augmented.segments.members
    ]
    asked = pairs if pairs is not None else [(a, b) for a in range(count) for b in range(a + 1, count)]
    for a, b in asked:
        key = (min(a, b), max(a, b))
        # the parent is the segment with a frame; of two with a frame the larger, so that the order does not
        # matter
        first = known[a] and (not known[b] or size[a] >= size[b])
        parent, child = (a, b) if first else (b, a)
        if key in used:
            parent, child = used[key][0].parent, used[key][0].child
        if key in found or not known[parent]:
            continue
        between = relative_motion(
            augmented.positions, augmented.seen, augmented.segments, augmented.frames, parent, child, noise
        )
        if between is None:
            continue
        joint, old = find_joint(between, parent, child, method), used.get(key)
        found[key] = (
            (joint, joint_cost(joint, between))
            if old is None
            else (_add_child_frame(old[0], joint, between), old[1])
        )


def _add_child_frame(old: Joint, new: Joint, motion: RelativeMotion) -> Joint:
    """Keep a joint from before the child had a frame, and add its position and axis in the child."""
    if motion.rotations is None or motion.translations is None:
        return old
    back = np.einsum("fba,fb->fa", motion.rotations, old.in_parent - motion.translations)
    return old._replace(
        in_child=np.median(back, axis=0),
        axis_in_parent=new.axis_in_parent,
        axis_in_child=new.axis_in_child,
    )


def _segments_without_frame(augmented: AugmentedMarkers) -> set[int]:
    return set(np.flatnonzero(~augmented.frames.known.any(0)).tolist())


def _cheapest_pairs(found, count: int) -> list[tuple[int, int]]:
    """Find the pairs of segments of the minimum spanning tree, or forest."""
    pairs = list(found)
    edges = spanning_tree(
        np.array([found[pair][1] for pair in pairs]), np.array(pairs, int).reshape(-1, 2), count
    )
    return [pairs[edge] for edge in edges]


def median_distance(positions: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]) -> float:
    """Compute the median distance of the markers in the frame that shows most of them, metres."""
    frame = int(np.argmax(seen.sum(1)))
    some = positions[frame, seen[frame]]
    return float(np.median(np.linalg.norm(some[:, None] - some[None], axis=-1)))


def _root_tree(augmented: AugmentedMarkers, pairs: list[tuple[int, int]], found) -> SegmentTree:
    """Root each connected component at the segment that balances the markers around it."""
    count = augmented.segments.num_segments
    size = np.array([len(some) for some in augmented.segments.members], float)
    around: list[list[int]] = [[] for _ in range(count)]
    for a, b in pairs:
        around[a].append(b)
        around[b].append(a)

    def weigh(segment: int, above: int) -> float:
        return float(size[segment]) + sum(
            weigh(other, segment) for other in around[segment] if other != above
        )

    heaviest = [max([0.0, *(weigh(o, k) for o in around[k])]) for k in range(count)]
    joints: list[Joint | None] = [None] * count
    parents, costs = [-2] * count, np.zeros(count)
    for root in sorted(range(count), key=lambda k: (heaviest[k], -len(around[k]))):
        if parents[root] != -2 or not _is_component_root(root, around, heaviest):
            continue
        parents[root] = -1
        stack = [root]
        while stack:
            above = stack.pop()
            for segment in around[above]:
                if parents[segment] != -2:
                    continue
                joint, cost = found[min(above, segment), max(above, segment)]
                parents[segment], costs[segment] = above, cost
                joints[segment] = joint if joint.parent == above else _flip_joint(augmented, joint)
                stack.append(segment)
    return SegmentTree(tuple(parents), align_hinge_centres(tuple(parents), tuple(joints)), costs, augmented)


def _is_component_root(root: int, neighbours: list[list[int]], branch_weights: list[float]) -> bool:
    piece, stack = {root}, [root]
    while stack:
        for other in neighbours[stack.pop()]:
            if other not in piece:
                piece.add(other)
                stack.append(other)
    return branch_weights[root] == min(branch_weights[k] for k in piece)


def _flip_joint(augmented: AugmentedMarkers, joint: Joint) -> Joint:
    both = augmented.frames.known[:, joint.parent] & augmented.frames.known[:, joint.child]
    frame = int(np.argmax(both))
    r = augmented.frames.rotations[frame]
    return joint.flipped(r[joint.child].T @ r[joint.parent])
