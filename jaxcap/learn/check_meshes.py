"""Validation of registered meshes before a body is learned from them."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from ..errors import InputError
from ..geometry.mesh import area_normals, mesh_edges, triangle_sides
from ..geometry.sampling import even_indices
from ..observe.meshes import MeshSequence
from ..units import BODY_SIZE, likely_units

#: bounds of the size of a body, metres: other sizes are in another unit, and those outside of `BODY_SIZE` probably
POSSIBLE_SIZE = (0.02, 30.0)
#: poses change the size of a body by less than this factor, a wrong unit by more
MAX_POSE_RATIO = 2.0
#: two people of any age differ in size by less than this factor, and two units by more
MAX_PERSON_RATIO = 5.0
#: an edge whose length differs by more than this factor is taken to join other vertices
STRETCH = 2.5
#: two meshes where more than this share of the edges differs have different vertex orders
MAX_DIFFERENT_SHARE = 0.25
#: the number of edges sampled for the comparison of vertex orders
EDGES = 3000
#: an edge is torn if it is longer than its median length and than the mean median length by this factor
TORN = 8.0


#: the least enclosed volume whose sign counts, relative to the cube of the standard deviation of the vertices
MIN_VOLUME = 0.01
#: length of the sum of all area vectors, as a share of the area, above which a surface is far from closed
MAX_GAP = 0.2
#: components with more than this share of the vertices of the largest one may be subjects of their own; the least change of
#: the distance between two subjects, as a share of the body's length
MIN_SUBJECT_SHARE, MIN_SUBJECT_MOTION = 0.3, 0.25
#: components with a distance of the first share of the body's length in all compared meshes, which changes by the second share,
#: are subjects too, and neither layers nor pieces of one
MIN_SUBJECT_GAP, MIN_SUBJECT_SWAY, COMPARED_MESHES = 0.05, 0.01, 5


class _Group(NamedTuple):
    """Meshes whose edge lengths agree with those of the first mesh in the group."""

    members: list[int]
    logs: Float[np.ndarray, "E"]
    size: float


def check_meshes(
    sequence: MeshSequence, names: Sequence[str] | None = None, owners: Int[np.ndarray, "F"] | None = None
) -> list[str]:
    """Check that a body can be learned from registered meshes.

    Returns warnings, one sentence each, about properties that may be intended: disconnected pieces, edges of
    more than two triangles, duplicate vertices, triangles without area, single torn vertices, an unusual
    size, triangles that face inwards, two subjects.

    **Arguments:** `names` are the names of the meshes in messages; `owners`, the number of the person of each mesh, if there are
    several people: sizes are compared, and motion is expected, among the meshes of one person.

    **Raises:** `InputError` for fewer than two meshes, numbers that are not finite, faces with invalid vertex
    indices, vertices of no triangle, meshes with another vertex order or unit than the others (detected by
    edge lengths), meshes that are mirrored, meshes that differ by a rigid motion only (of several people: those of each), a surface that is disconnected because of
    duplicate vertices, an impossible size.
    """
    vertices, faces = np.asarray(sequence.vertices, float), np.asarray(sequence.faces)
    called = list(names) if names is not None else [f"mesh {number}" for number in range(len(vertices))]
    if len(called) != len(vertices):
        raise ValueError(
            f"There are {len(vertices)} meshes and {len(called)} names; expected one name per mesh."
        )
    if len(vertices) < 2:
        raise InputError(
            f"The sequence has {'one mesh only' if len(vertices) else 'no mesh'} and contains no motion; "
            "expected at least two; give meshes in poses that move every joint."
        )
    _check_arrays(vertices, faces, called)
    edges = mesh_edges(faces)
    _check_order(vertices, edges, called)
    own = [np.arange(len(vertices))] if owners is None else [np.flatnonzero(owners == n) for n in set(owners)]
    _check_unit(vertices, edges, called, np.array([rows[0] for rows in own]), MAX_PERSON_RATIO)
    for rows in own:
        _check_unit(vertices, edges, called, rows, MAX_POSE_RATIO)
    inward = _check_orientation(vertices, faces, called)
    extent = float(np.median(np.ptp(vertices, axis=1).max(1)))
    messages = [
        *_size(extent),
        *inward,
        *_check_displaced_vertices(vertices, edges, called),
        *_surface(vertices, faces, edges, extent),
        *_check_subjects(vertices, edges, extent),
    ]
    if not any(shows_motion(vertices[rows]) for rows in own):
        raise InputError(
            f"The meshes {'of each person ' if len(own) > 1 else ''}differ by a rigid motion only; expected several poses; give "
            "meshes in poses that move every joint."
        )
    return messages


def _check_arrays(vertices: np.ndarray, faces: np.ndarray, names: list[str]) -> None:
    count = vertices.shape[1]
    finite = np.asarray(np.isfinite(vertices).all(2))
    if not finite.all():
        frame = int(np.argmin(finite.all(1)))
        raise InputError(
            f"{names[frame]} has {(~finite[frame]).sum()} vertices that are not finite, the first is vertex "
            f"{int(np.argmin(finite[frame]))}; repair this mesh or leave it out."
        )
    if len(faces) == 0:
        raise InputError("The meshes have no triangles; expected a surface, not a point cloud.")
    if faces.min() < 0 or faces.max() >= count:
        raise InputError(
            f"A triangle has vertex {faces.min() if faces.min() < 0 else faces.max()}; expected vertices "
            f"from 0 to {count - 1}."
        )
    used = np.zeros(count, bool)
    used[faces] = True
    if not used.all():
        raise InputError(
            f"{(~used).sum()} of {count} vertices are in no triangle, the first is vertex "
            f"{int(used.argmin())}; remove them from all meshes."
        )
    sizes = np.ptp(vertices, axis=1).max(1)
    if (sizes == 0).any():
        raise InputError(f"{names[int(sizes.argmin())]} is a single point; leave this mesh out.")


def _lengths(vertices: np.ndarray, edges: np.ndarray) -> Float[np.ndarray, "F E"]:
    return np.stack([np.linalg.norm(mesh[edges[:, 0]] - mesh[edges[:, 1]], axis=1) for mesh in vertices])


def _check_order(vertices: np.ndarray, edges: np.ndarray, names: list[str]) -> None:
    """Check that all meshes share one vertex order.

    Meshes are grouped by their edge lengths, and all must be in one group. The poses of a body stretch few of
    its edges; another vertex order changes edges everywhere.
    """
    logs = _edge_logs(vertices, edges)
    sizes = np.log(np.sqrt(vertices.var(1).sum(1)))
    groups: list[_Group] = []
    for frame, (row, size) in enumerate(zip(logs, sizes, strict=True)):
        disagreements = [_disagreement(row - group.logs, size - group.size) for group in groups]
        best = int(np.argmin(disagreements)) if disagreements else -1
        if disagreements and disagreements[best] <= MAX_DIFFERENT_SHARE:
            groups[best].members.append(frame)
        else:
            groups.append(_Group([frame], row, size))
    main = max(groups, key=lambda group: len(group.members))
    others = sorted(frame for group in groups if group is not main for frame in group.members)
    if others:
        many = f"the other {len(main.members)}" if len(main.members) > 1 else names[main.members[0]]
        raise InputError(
            f"{_listed(others, names)} {'has' if len(others) == 1 else 'have'} a different vertex order than "
            f"{many}: edge lengths differ by more than a factor of {STRETCH:g} across the mesh; expected "
            "registered meshes with one vertex order; register them by `jaxcap register`."
        )


def _check_unit(
    vertices: np.ndarray, edges: np.ndarray, names: list[str], rows: Int[np.ndarray, "M"], most: float
) -> None:
    """Check that some meshes of one vertex order share one unit: their sizes differ by at most a factor."""
    factors = relative_sizes(vertices[rows], edges)
    wrong = np.flatnonzero(np.abs(np.log(factors)) > np.log(most))
    if wrong.size:
        raise InputError(
            f"{_listed(rows[wrong].tolist(), names)} {'is' if wrong.size == 1 else 'are'} {factors[wrong[0]]:.4g} "
            "times as large as the others; give all meshes in one unit."
        )


def relative_sizes(
    vertices: Float[np.ndarray, "F V 3"], edges: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, "F"]:
    """Compute the size of each mesh relative to the median of all, by the lengths of some edges."""
    logs = _edge_logs(vertices, edges)
    return np.exp(np.median(logs - np.median(logs, axis=0), axis=1))


def _edge_logs(vertices: np.ndarray, edges: np.ndarray) -> Float[np.ndarray, "F E"]:
    """Compute the logarithms of the lengths of some edges."""
    few = edges[np.random.default_rng(0).permutation(len(edges))[:EDGES]]
    lengths = _lengths(vertices, few)
    return np.log(np.maximum(lengths, 1e-9 * lengths.max()))


def _disagreement(ratios: Float[np.ndarray, "E"], growth: float) -> float:
    """Return the share of edges that differ in length, after removing a change of unit and a global scale."""
    ratios = ratios - (growth if abs(growth) > np.log(MAX_POSE_RATIO) else 0.0)
    ratios = ratios - np.clip(np.median(ratios), -np.log(MAX_POSE_RATIO), np.log(MAX_POSE_RATIO))
    return float(np.mean(np.abs(ratios) > np.log(STRETCH)))


def _check_orientation(vertices: np.ndarray, faces: np.ndarray, names: list[str]) -> list[str]:
    """Check that the triangles of all meshes face the same side, by the signs of the enclosed volumes.

    Edges of a mirrored mesh are as long as those of the others, so that `_check_order` accepts it. Surfaces that enclose
    hardly any volume, or are far from closed, have no sign.
    """
    moved = vertices - vertices.mean(1, keepdims=True)
    volumes = np.array([np.linalg.det(mesh[faces]).sum() / 6 for mesh in moved])
    sizes = np.sqrt(vertices.var(1).sum(1)) ** 3
    # the areas of a closed surface, as vectors, add up to zero
    areas = area_normals(vertices[:, faces])
    gaps = np.linalg.norm(areas.sum(1), axis=1) / np.linalg.norm(areas, axis=2).sum(1)
    sure = (np.abs(volumes) > MIN_VOLUME * sizes) & (gaps < MAX_GAP)
    positive = int((volumes[sure] > 0).sum())
    if 0 < positive < sure.sum():
        main = positive >= sure.sum() / 2
        wrong = np.flatnonzero(sure & ((volumes > 0) != main)).tolist()
        raise InputError(
            f"{_listed(wrong, names)} {'is' if len(wrong) == 1 else 'are'} mirrored: the triangles face "
            f"{'inwards' if main else 'outwards'}, and those of the other meshes {'outwards' if main else 'inwards'}; mirror "
            f"{'it' if len(wrong) == 1 else 'them'} back or leave {'it' if len(wrong) == 1 else 'them'} out."
        )
    if sure.any() and positive == 0:
        return [
            "The triangles of all meshes face inwards: the meshes are mirrored, or the vertices of their triangles are in the "
            "other order; no person is recognised in such meshes, and left and right are exchanged in mirrored ones."
        ]
    return []


def _check_subjects(vertices: np.ndarray, edges: np.ndarray, extent: float) -> list[str]:
    """Warn of large components whose distance changes, or that are never close to each other, such as two people."""
    labels = _components(edges, vertices.shape[1])[1]
    counts = np.bincount(labels)
    large = np.flatnonzero(counts >= MIN_SUBJECT_SHARE * counts.max())
    if len(large) == 1:
        return []
    parts = [vertices[:, labels == label] for label in large]
    middles = np.stack([part.mean(1) for part in parts])
    change = np.ptp(np.linalg.norm(middles[:, None] - middles, axis=-1), axis=2).max()
    if change >= MIN_SUBJECT_MOTION * extent:
        reason = f"whose distance changes by {change:.2f} m"
    elif change < MIN_SUBJECT_SWAY * extent:
        return []
    else:
        some = even_indices(len(vertices), COMPARED_MESHES)
        pairs = list(itertools.combinations(parts, 2))
        closest = min(KDTree(one[m]).query(other[m])[0].min() for m in some for one, other in pairs)
        if closest < MIN_SUBJECT_GAP * extent:
            return []
        reason = f"which are never closer than {closest:.2f} m"
    return [
        f"The meshes contain {len(large)} subjects: components of {_numbers(counts[large])} vertices, {reason}; learn each of "
        "them from meshes of its own."
    ]


def _numbers(counts: np.ndarray) -> str:
    return f"{', '.join(map(str, counts[:-1].tolist()))} and {counts[-1]}"


def _size(extent: float) -> list[str]:
    if BODY_SIZE[0] <= extent <= BODY_SIZE[1]:
        return []
    likely = likely_units(extent, *BODY_SIZE)
    hint = (
        f"the unit is probably {likely[0]}: pass unit='{likely[0]}' or --unit {likely[0]}"
        if likely
        else "check the unit"
    )
    message = f"The meshes are {extent:.4g} m long; expected a body of {BODY_SIZE[0]:g} to {BODY_SIZE[1]:g} m; {hint}."
    if not POSSIBLE_SIZE[0] <= extent <= POSSIBLE_SIZE[1]:
        raise InputError(message)
    return [message]


def _check_displaced_vertices(vertices: np.ndarray, edges: np.ndarray, names: list[str]) -> list[str]:
    """Warn of single vertices that are displaced in some mesh, as after a registration error."""
    lengths = _lengths(vertices, edges)
    usual = np.median(lengths, axis=0)
    far = (lengths > TORN * usual) & (lengths > TORN * usual.mean())
    frames = np.flatnonzero(far.any(1)).tolist()
    if not frames:
        return []
    # find the vertex that most torn edges share
    ends = np.bincount(edges[far[frames[0]]].reshape(-1))
    return [
        f"{_listed(frames, names)} {'has' if len(frames) == 1 else 'have'} displaced vertices: edges are "
        f"more than {TORN:g} times as long as in the other meshes, such as those of vertex "
        f"{int(ends.argmax())}; repair these meshes or leave them out."
    ]


def _surface(vertices: np.ndarray, faces: np.ndarray, edges: np.ndarray, extent: float) -> list[str]:
    count, messages = vertices.shape[1], []
    twin = _find_duplicates(vertices, 1e-6 * extent)
    num_separate, num_merged = (
        _num_components(edges, count),
        _num_components(twin[edges], count) - int((twin != np.arange(count)).sum()),
    )
    twice = int((twin != np.arange(count)).sum())
    if num_separate > num_merged:
        raise InputError(
            f"The surface has {num_separate} connected components instead of {num_merged}, because {twice} vertices "
            f"are duplicates, such as vertex {int(np.argmax(twin != np.arange(count)))}; merge duplicates in "
            "the same way in all meshes."
        )
    if twice:
        messages.append(
            f"{twice} vertices are duplicates of others in all meshes, such as vertex "
            f"{int(np.argmax(twin != np.arange(count)))}."
        )
    if num_separate > 1:
        messages.append(
            f"The surface has {num_separate} connected components; each follows the joints that fit it, and parts "
            "of different components are adjacent only where they are close to each other."
        )
    corners = np.sort(triangle_sides(faces), axis=1)
    shared = np.unique(corners, axis=0, return_counts=True)[1]
    if (shared > 2).any():
        messages.append(
            f"The surface is not a manifold: {(shared > 2).sum()} edges belong to more than two triangles, "
            f"at most to {shared.max()}."
        )
    flat = (np.linalg.norm(area_normals(vertices[:, faces]), axis=2) <= 1e-12 * extent**2).all(0)
    if flat.any():
        messages.append(
            f"{flat.sum()} triangles have no area in any mesh, such as triangle {int(flat.argmax())}."
        )
    return messages


def shows_motion(vertices: Float[np.ndarray, "F V 3"]) -> bool:
    """Test if distances between some sampled vertices change, so that meshes differ by more than a rigid motion."""
    few = vertices[:, even_indices(vertices.shape[1], 60)]
    distances = np.linalg.norm(few[:, :, None] - few[:, None], axis=3)
    return bool(np.ptp(distances, axis=0).max() >= 1e-4 * np.ptp(vertices, axis=1).max())


def _find_duplicates(vertices: np.ndarray, near: float) -> Int[np.ndarray, "V"]:
    """Map each vertex to the first vertex with the same position in all meshes, or to itself."""
    cells = np.round(np.concatenate([vertices[0], vertices[-1]], axis=1) / near).astype(np.int64)
    _, first, inverse = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    twin = first[inverse.reshape(-1)]
    same = (np.abs(vertices - vertices[:, twin]) <= near).all((0, 2))
    return np.where(same, twin, np.arange(len(twin)))


def _num_components(edges: np.ndarray, count: int) -> int:
    return _components(edges, count)[0]


def _components(edges: np.ndarray, count: int) -> tuple[int, Int[np.ndarray, "V"]]:
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    number, labels = connected_components(graph, directed=False)
    return int(number), labels


def _listed(frames: Sequence[int], names: list[str], most: int = 5) -> str:
    listed = ", ".join(names[frame] for frame in frames[:most])
    return listed if len(frames) <= most else f"{listed} and {len(frames) - most} more"
