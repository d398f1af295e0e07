"""The tree of joints between rigid parts."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ...body.pose import Pose
from ...body.skeleton import Skeleton, make_skeleton
from ...geometry import rotation
from ...geometry.mesh import box_diagonal
from ...geometry.sampling import even_indices
from ...geometry.spanning_tree import spanning_tree
from ..parts.find_parts import RigidParts
from ..parts.surface_graph import make_surface_graph
from ..symmetry.mirrored_parts import mirror_parts
from ..symmetry.surface_symmetry import SurfaceSymmetry
from .centres import Centres, PartBoundaries, find_boundaries, find_centres
from .pose_from_parts import fit_poses, motion_moments
from .symmetric_tree import symmetric_joint_costs

#: cost of a short boundary, as a share of the error of the parts
BOUNDARY_COST = 0.5
#: frames used to connect the pieces of a mesh
FRAMES = 16

_shortest_arc = jax.jit(rotation.shortest_arc)


class JointTree(NamedTuple):
    """A skeleton with its parts: bone `j` is part `j` of `parts`."""

    skeleton: Skeleton
    parts: RigidParts
    #: (J,) root mean square distance between the positions of a joint centre under its two parts, metres;
    #: zero at the root
    residuals: Float[np.ndarray, "J"]
    #: (J,) area of each part, as a share of the whole
    areas: Float[np.ndarray, "J"]


def find_joint_tree(
    parts: RigidParts,
    rest: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "T 3"],
    symmetry: SurfaceSymmetry | None = None,
) -> JointTree:
    """Connect rigid parts by joints at their common points, in the spanning tree with the least gaps.

    Adjacent parts are joined at the point that both move alike (`find_centres`). The skeleton is the spanning
    tree with the least sum of gaps there, with a penalty for short boundaries. The root is the part that
    balances the areas of the branches. The x axis of each joint points to the next joint, at a fork to the
    mean of the next joints, at a leaf to the mean of the part's vertices (Adaptation, section 3.2.1). With a `symmetry` of the
    surface the tree is symmetric (`symmetric_joint_costs`).

    **Returns:** a skeleton with a "free" root and "ball" joints, named `root`, `joint1`, ... parents first,
    and the parts in the order of its bones.
    """
    rest, faces = np.asarray(rest, float), np.asarray(faces)
    count = parts.num_parts
    chosen = even_indices(len(parts.rotations), FRAMES, nearest=True)
    moved = np.einsum("fvab,vb->fva", parts.rotations[chosen][:, parts.labels], rest)
    surface = make_surface_graph(rest, moved + parts.translations[chosen][:, parts.labels], faces)
    areas = np.bincount(parts.labels, surface.areas, count)
    size = box_diagonal(rest)
    means = np.stack([np.bincount(parts.labels, surface.areas * rest[:, i], count) for i in range(3)], 1)
    means = means / areas[:, None]
    if count == 1:
        return _make_tree(parts, [0], [-1], means, means, np.zeros(1), areas)
    seams = find_boundaries(surface, parts.labels, rest, count)
    centres = find_centres(seams, parts.rotations, parts.translations, size, parts.error)
    costs = _joint_costs(seams, centres, parts.error)
    if symmetry is not None:
        partners = mirror_parts(parts.labels, surface.areas, symmetry.mirrored, count).partners
        costs = symmetric_joint_costs(costs, seams.pairs, partners, areas)
    joints = spanning_tree(costs, seams.pairs, count).tolist()
    order, above, joint = _from_root(seams.pairs[joints], joints, areas)
    place = [means[order[0]] if j < 0 else centres.points[j] for j in joint]
    gaps = np.array([0.0 if j < 0 else centres.residuals[j] for j in joint])
    return _make_tree(parts, order, above, np.array(place), means[order], gaps, areas[order])


def pose_parts(skeleton: Skeleton, parts: RigidParts, rest: Float[np.ndarray, "V 3"]) -> Pose:
    """Fit poses, stacked over the frames, in which each bone follows the part of the same index."""
    rest = np.asarray(rest, float)
    moments = motion_moments(rest, parts.labels, np.ones(len(rest)), parts.rotations, parts.translations)
    return fit_poses(skeleton, moments)


def orient(
    parents: list[int], centres: Float[np.ndarray, "J 3"], ends: Float[np.ndarray, "J 3"]
) -> Float[np.ndarray, "J 4"]:
    """Compute quaternions that rotate x towards the mean of the next joints, and at leaves towards `ends`.

    Joints without a direction get the identity.
    """
    towards = np.array(ends, float)
    for j in range(len(parents)):
        children = [k for k, parent in enumerate(parents) if parent == j]
        if children:
            towards[j] = np.mean(centres[children], axis=0)
    away = towards - centres
    lengths = np.linalg.norm(away, axis=1, keepdims=True)
    known = lengths[:, 0] > 1e-6 * max(float(lengths.max()), 1e-300)
    away = np.where(known[:, None], away / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0, 0.0])
    return np.asarray(_shortest_arc(jnp.broadcast_to(jnp.eye(3)[0], away.shape), jnp.asarray(away)))


def _joint_costs(seams: PartBoundaries, centres: Centres, error: float) -> np.ndarray:
    """Compute the cost of each possible joint, metres: its gap, and a penalty for a short boundary.

    The boundary is compared with the longest one of either part.
    """
    longest = np.zeros(seams.pairs.max() + 1)
    np.maximum.at(longest, seams.pairs.ravel(), np.repeat(seams.lengths, 2))
    either = longest[seams.pairs].min(1)
    share = seams.lengths / np.where(either > 0, either, 1.0)
    return centres.residuals + BOUNDARY_COST * error * (1 - share) + seams.gaps


def _from_root(
    pairs: np.ndarray, joints: list[int], areas: np.ndarray
) -> tuple[list[int], list[int], list[int]]:
    """Order the parts depth first from the root, the larger branches first.

    Returns the order, the position of each parent in it, and the joint to each parent, -1 at the root.
    """
    around: list[list[tuple[int, int]]] = [[] for _ in areas]
    for (a, b), joint in zip(pairs.tolist(), joints, strict=True):
        around[a].append((b, joint))
        around[b].append((a, joint))

    def weigh(part: int, parent: int) -> float:
        return float(areas[part]) + sum(weigh(other, part) for other, _ in around[part] if other != parent)

    heaviest = [max(weigh(other, part) for other, _ in around[part]) for part in range(len(areas))]
    order, above, joint = [], [], []

    def visit(part: int, parent: int, place: int, by: int) -> None:
        order.append(part)
        above.append(place)
        joint.append(by)
        index = len(order) - 1
        for other, via in sorted(around[part], key=lambda to: -weigh(to[0], part)):
            if other != parent:
                visit(other, part, index, via)

    visit(int(np.argmin(heaviest)), -1, -1, -1)
    return order, above, joint


def _make_tree(parts: RigidParts, order, above, centres, ends, residuals, areas) -> JointTree:
    """Build the skeleton, and reorder the parts to match."""
    count = len(order)
    place = np.empty(count, int)
    place[np.array(order)] = np.arange(count)
    names = ["root"] + [f"joint{j}" for j in range(1, count)]
    kinds = ["free"] + ["ball"] * (count - 1)
    skeleton = make_skeleton(names, above, kinds, centres, orient(above, centres, ends))
    sorted_parts = parts._replace(
        labels=place[parts.labels],
        rotations=parts.rotations[:, order],
        translations=parts.translations[:, order],
        partners=place[parts.partners],
    )
    return JointTree(skeleton, sorted_parts, np.asarray(residuals), np.asarray(areas))
