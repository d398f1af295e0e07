"""Edits of a body with a left-right symmetry: in pairs or on the middle."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...body.body import Body
from ...body.pose import Pose
from ...geometry.mesh import box_diagonal
from ...geometry.procrustes import nearest_rotation
from ..skeleton.reparent import MAX_CENTRE_SHIFT, bone_motions, common_points
from ..symmetry.surface_symmetry import SurfaceSymmetry
from ..symmetry.symmetric_skeleton import make_symmetric, mirrored_joints
from .insert_and_remove import EditedBody, Removal, Split, fit_edited_poses, split_motions

#: least overlap of a new bone with the mirrored other one, intersection over union of their vertices
MIN_OVERLAP = 0.3
#: the number of vertices around a joint whose mirrored points show where the mirrored joint is
NEAR = 80
#: weight from which a vertex belongs to a new bone
CORE = 0.5


def make_edit_symmetric(made: EditedBody, symmetry: SurfaceSymmetry) -> EditedBody:
    """Pair the joints of an edited body, make its skeleton symmetric, and fit the poses to the motions of the bones."""
    body = made.body
    labels, rest = np.asarray(body.skin.dominant_bones()), np.asarray(body.vertices, float)
    found = make_symmetric(body.skeleton, labels, rest, np.asarray(body.faces), symmetry)
    bones = bone_motions(body.skeleton, made.poses)
    poses = fit_edited_poses(found.skeleton, bones, rest, labels)
    poses = jax.tree.map(lambda leaf: jnp.asarray(leaf, body.vertices.dtype), poses)
    return EditedBody(eqx.tree_at(lambda b: b.skeleton, body, found.skeleton), poses, found.pairs)


def count_unpaired(body: Body, symmetry: SurfaceSymmetry) -> int:
    """Count the joints that are neither in a pair nor on the middle."""
    joints = mirrored_joints(body, symmetry)
    return int((joints.partners < 0).sum())


def group_splits(splits: Sequence[Split], symmetry: SurfaceSymmetry | None) -> list[tuple[Split, ...]]:
    """Group splits with their mirror images, and leave out those with none that are not on the middle either.

    The groups are in order of the mean gain of their splits. Without a symmetry every split is a group.
    """
    if symmetry is None:
        return [(split,) for split in splits]
    cores = [_core(split, len(symmetry.sides)) for split in splits]
    mirrored = symmetry.mirrored
    overlaps = np.array([[_overlap(core, other[mirrored]) for other in cores] for core in cores])
    groups, taken = [], set()
    for row, split in enumerate(splits):
        if row in taken:
            continue
        shares = np.where([other in taken for other in range(len(splits))], 0.0, overlaps[row])
        partner = int(np.argmax(shares))
        if shares[partner] < MIN_OVERLAP:
            continue
        group = (split,) if partner == row else (split, splits[partner])
        # both may hang below one joint, but not move one joint to two parents
        if len(group) == 1 or not _children(group[0]) & _children(group[1]):
            taken |= {row, partner}
            groups.append(group)
    return sorted(groups, key=lambda group: -float(np.mean([split.gain for split in group])))


def mirror_groups(
    groups: Sequence[tuple[Split, ...]], body: Body, poses: Pose, symmetry: SurfaceSymmetry
) -> list[tuple[Split, ...]]:
    """Mirror the tree of the first split of each pair for the second one, so that both have the same place in the tree.

    Its joints are where the motions of its own bones have common points, near the mirrored joints.
    """
    partners = mirrored_joints(body, symmetry).partners
    rest = np.asarray(body.vertices, float)
    points, size = symmetry.mirrored_points(rest), box_diagonal(rest)
    bones = bone_motions(body.skeleton, poses)

    def mirror(first: Split, second: Split) -> Split:
        place = np.append(partners, len(partners))
        rows = [(int(place[joint]), int(place[above]), centre) for joint, above, centre in first.reparented]
        if any(joint < 0 or above < 0 for joint, above, _ in rows):
            return second
        reach = MAX_CENTRE_SHIFT * size
        wanted = [(joint, above, mirror_point(centre, rest, points), reach) for joint, above, centre in rows]
        centres, _ = common_points(wanted, split_motions(bones, second), size)
        return second._replace(
            reparented=tuple((*row[:2], centre) for row, centre in zip(rows, centres, strict=True))
        )

    return [group if len(group) == 1 else (group[0], mirror(*group)) for group in groups]


def mirror_point(
    point: Float[np.ndarray, "3"], vertices: Float[np.ndarray, "V 3"], mirrored: Float[np.ndarray, "V 3"]
) -> Float[np.ndarray, "3"]:
    """Map a point to the other side, by the reflection that maps the vertices around it best to their mirrored points."""
    near = np.argsort(np.sum((vertices - point) ** 2, 1))[:NEAR]
    source, target = vertices[near].mean(0), mirrored[near].mean(0)
    # the best rotation after a reflection through the origin
    turn = nearest_rotation(-(mirrored[near] - target).T @ (vertices[near] - source))
    return target - turn @ (point - source)


def group_removals(
    removals: Sequence[Removal], pairs: Int[np.ndarray, "P 2"] | None
) -> list[tuple[Removal, ...]]:
    """Group the removals of paired joints; without pairs every removal is a group. The cheapest group comes first."""
    if pairs is None:
        return [(removal,) for removal in removals]
    by_joint = {removal.joint: removal for removal in removals}
    partners = {int(a): int(b) for pair in pairs for a, b in (pair, pair[::-1])}
    groups = []
    for removal in removals:
        partner = partners.get(removal.joint)
        if partner is None or partner not in by_joint:
            groups.append((removal,))
        elif removal.joint < partner:
            groups.append((removal, by_joint[partner]))
    return sorted(groups, key=lambda group: float(np.mean([removal.cost for removal in group])))


def _core(split: Split, count: int) -> Bool[np.ndarray, "V"]:
    core = np.zeros(count, bool)
    core[split.vertices[split.weights[:, -1] > CORE]] = True
    return core


def _overlap(first: Bool[np.ndarray, "V"], second: Bool[np.ndarray, "V"]) -> float:
    return float((first & second).sum() / max((first | second).sum(), 1))


def _children(split: Split) -> set[int]:
    """Return the existing joints that a split gives another parent."""
    return {joint for joint, _, _ in split.reparented} - {split.weights.shape[1] - 1}
