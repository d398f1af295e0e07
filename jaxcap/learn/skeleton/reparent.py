"""World motions of bones, and new joints between bones that had none."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...geometry import rotation
from ...geometry.mesh import box_diagonal
from ...geometry.spanning_tree import spanning_tree
from ..parts.surface_graph import SurfaceGraph
from .centres import PartBoundaries, find_boundaries, find_centres
from .pose_from_parts import world_transforms

#: distance, as a share of the body's diagonal, within which the centre of a joint with a new parent may move
MAX_CENTRE_SHIFT = 0.03
#: a new joint replaces an existing one if its gap is below this share of the existing gap
REPLACEMENT_RATIO = 0.8


class BoneMotions(NamedTuple):
    """World motions of J bones in F frames, without the scale of the poses, which is one in learning."""

    rotations: Float[np.ndarray, "F J 3 3"]
    translations: Float[np.ndarray, "F J 3"]


def bone_motions(skeleton: Skeleton, poses: Pose) -> BoneMotions:
    """Compute the transforms of bones in every frame, in NumPy, to avoid compilation for each new tree."""
    local = np.asarray(_matrices(poses.rotations), float).swapaxes(0, 1)
    shifts = np.asarray(poses.translations, float).swapaxes(0, 1)
    centres = np.asarray(skeleton.centres, float)
    found = world_transforms(centres, np.array(skeleton.parents), local, shifts)
    return BoneMotions(*(part.swapaxes(0, 1) for part in found))


def reparent_children(
    skeleton: Skeleton, bones: BoneMotions, joint: int, rest: Float[np.ndarray, "V 3"]
) -> dict[int, tuple[int, Float[np.ndarray, "3"], float]]:
    """Choose the new parent and centre of each child of a removed joint, by the spanning tree of least gaps.

    Returns parent, centre and root mean square gap, metres, by child.
    """
    parent, centres = skeleton.parents[joint], np.asarray(skeleton.centres, float)
    children = [j for j, above in enumerate(skeleton.parents) if above == joint]
    if not children:
        return {}
    size = box_diagonal(rest)
    ends = [parent, *children]
    positions = [centres[joint], *centres[children]]
    picked = [(a, b) for a in range(len(ends)) for b in range(a + 1, len(ends))]
    rows = [
        (
            ends[a],
            ends[b],
            (positions[a] + positions[b]) / 2,
            max(float(np.linalg.norm(positions[a] - positions[b])) / 2, MAX_CENTRE_SHIFT * size),
        )
        for a, b in picked
    ]
    points, gaps = common_points(rows, bones, size)
    edges = spanning_tree(gaps, np.array(picked, int).reshape(-1, 2), len(ends)).tolist()
    return {
        ends[child]: (ends[above], points[edge], float(gaps[edge]))
        for child, above, edge in _directed_edges(edges, picked)
    }


def reparent_new_bone(
    skeleton: Skeleton,
    bones: BoneMotions,
    labels: Int[np.ndarray, "V"],
    surface: SurfaceGraph,
    rest: Float[np.ndarray, "V 3"],
) -> tuple[tuple[int, int, Float[np.ndarray, "3"]], ...]:
    """Choose the parent of a new bone and the joints below it, as rows of joint, parent and centre.

    The new bone is the last one of `bones` and `labels`. The result is the spanning tree of least gaps among
    existing joints and possible joints between the new bone and adjacent parts. An existing joint is only
    replaced by a clearly better one.
    """
    count, size = skeleton.num_joints, box_diagonal(rest)
    centres = np.asarray(skeleton.centres, float)
    reach = MAX_CENTRE_SHIFT * size
    old = [(joint, parent) for joint, parent in enumerate(skeleton.parents) if parent >= 0]
    rows = [(parent, joint, centres[joint], reach) for joint, parent in old]
    # bones without vertices have no boundary
    shown, inverse = np.unique(labels, return_inverse=True)
    seams = find_boundaries(surface, inverse, rest, len(shown))
    rows += [
        (int(shown[first]), count, seams.centroids[row], seams.radii[row])
        for row, (first, second) in enumerate(seams.pairs)
        if shown[second] == count
    ]
    points, gaps = common_points(rows, bones, size)
    costs = np.where(np.arange(len(rows)) < len(old), REPLACEMENT_RATIO * gaps, gaps)
    edges = spanning_tree(costs, np.array([row[:2] for row in rows], int).reshape(-1, 2), count + 1).tolist()
    # a joint whose direction alone is reversed keeps its centre
    return tuple(
        (child, above, points[edge] if edge >= len(old) else rows[edge][2])
        for child, above, edge in _directed_edges(edges, [row[:2] for row in rows])
        if edge >= len(old) or skeleton.parents[child] != above
    )


def _directed_edges(edges: Sequence[int], pairs: Sequence[tuple]) -> list[tuple[int, int, int]]:
    """List child, parent and edge along a tree from node 0 outwards."""
    found, reached, seen = [], [0], {0}
    while reached:
        node = reached.pop()
        for edge in edges:
            first, second = pairs[edge]
            other = second if first == node else first if second == node else 0
            if other not in seen:
                seen.add(other)
                reached.append(other)
                found.append((other, node, edge))
    return found


def common_points(rows: Sequence[tuple], bones: BoneMotions, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Find the points that both bones of each row (bone, bone, prior centre, radius) move alike, and their
    gaps."""
    first, second, middles, radii = zip(*rows, strict=True)
    none = np.zeros(len(rows))
    seams = PartBoundaries(np.stack([first, second], 1), np.stack(middles), np.array(radii), none, none)
    found = find_centres(seams, bones.rotations, bones.translations, size)
    return found.points, found.residuals


_matrices = jax.jit(rotation.to_matrix)
