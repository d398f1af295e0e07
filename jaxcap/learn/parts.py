"""Rigid parts of a surface that moves: which vertices move together, and how."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..geometry.procrustes import Moments, group_moments, rigid_errors, rigid_motions
from .agglomerate import Merging, agglomerate, merged_labels
from .rest import choose_rest
from .surface import Surface, adjacency, connect, cut_patches, label_edges, make_surface, membership

#: patches that are merged into parts
PATCHES = 300
#: patches of a part by which it may be split in two
SPLIT_PATCHES = 24
#: one more part has to lower the root mean square error by this share
LEAST_GAIN = 0.04
#: share of the body's diagonal below which an error is that of numbers, not of parts
NEGLIGIBLE = 2e-4
#: the most parts that are found unasked
MOST_PARTS = 60
#: rounds of k-means, and how little may change for it to be done
ROUNDS, SETTLED = 30, 1e-3


class Parts(NamedTuple):
    """K rigid parts of V vertices in F frames; part `k` takes vertex `p` to
    `rotations[f, k] p + translations[f, k]`, metres."""

    labels: Int[np.ndarray, "V"]
    rotations: Float[np.ndarray, "F K 3 3"]
    translations: Float[np.ndarray, "F K 3"]
    #: the mean of all frames, each part carried back to where it stands in the mesh given as rest
    rest: Float[np.ndarray, "V 3"]
    #: (N,) root mean square error in metres with 1, 2, ... N parts, before they are refined
    curve: Float[np.ndarray, "N"]
    #: root mean square distance in metres of the vertices, weighted by area, to their rigid parts
    error: float

    @property
    def num_parts(self) -> int:
        """K, the number of parts."""
        return self.rotations.shape[1]


class Scene(NamedTuple):
    """What parts are found in: frames about their middles, so that little is lost to cancellation."""

    surface: Surface
    rest: Float[np.ndarray, "V 3"]
    #: vertex by vertex, where it is in every frame
    paths: Float[np.ndarray, "V F 3"]


def find_parts(
    meshes: Float[np.ndarray, "F V 3"],
    faces: Int[np.ndarray, "T 3"],
    count: int | None = None,
    rest: Float[np.ndarray, "V 3"] | None = None,
) -> Parts:
    """Connected parts of the surface that move rigidly, as nearly as so many parts can.

    Some hundred small patches are merged in the order that costs least rigidity, which gives the
    error over the number of parts; the parts are then refined by k-means with rigid motions
    (Le and Deng 2012), and where splitting one and merging two others lowers the error, that is
    done. Each vertex counts by its area.

    **Arguments:** `meshes` in one topology, metres; `faces` triangles; `count` how many parts,
    by default as many as each lower the error by `LEAST_GAIN`; `rest` the mesh in whose pose the
    parts rest, by default the one nearest to all others (`choose_rest`).

    **Raises:** `ValueError` for fewer than two meshes, numbers that are not finite, faces beyond
    the vertices, and a count that is not between one and the number of patches.
    """
    meshes, faces = np.asarray(meshes), np.asarray(faces)
    _check(meshes, faces, count)
    if rest is None:
        rest = meshes[choose_rest(meshes, faces)]
    rest = np.asarray(rest, float)
    surface = make_surface(rest, meshes, faces)
    paths = np.ascontiguousarray(meshes.transpose(1, 0, 2), float)
    middle, middles = surface.areas @ rest, np.einsum("v,vfa->fa", surface.areas, paths)
    scene = Scene(surface, rest - middle, paths - middles)
    patches, merging, scene = _merge_patches(scene, PATCHES)
    curve = np.sqrt(merging.errors / len(meshes))
    if count is None:
        count = choose_count(curve, float(np.linalg.norm(np.ptp(rest, axis=0))))
    elif count > len(curve):
        raise ValueError(f"The surface was asked for {count} parts but has only {len(curve)} patches.")
    labels = _improve(scene, merged_labels(merging, count)[patches], count)
    labels, moved = _refine(scene, labels, count)
    rotations, translations = rigid_motions(moved)
    back = _carried_back(scene, labels, rotations, translations)
    # about the world's origin again
    translations = translations + middles - np.einsum("kfab,b->kfa", rotations, middle)
    error = float(np.sqrt(rigid_errors(moved).sum() / len(meshes)))
    return Parts(labels, rotations.swapaxes(0, 1), translations.swapaxes(0, 1), back + middle, curve, error)


def choose_count(curve: Float[np.ndarray, "N"], size: float) -> int:
    """The number of parts at which one more no longer lowers the error by `LEAST_GAIN`, by the mean of
    the next three, or at which the error is negligible against the `size` of the body, metres."""
    for count in range(1, min(len(curve), MOST_PARTS)):
        ahead = min(count + 3, len(curve))
        share = 1 - (curve[ahead - 1] / max(curve[count - 1], 1e-300)) ** (1 / (ahead - count))
        if curve[count - 1] < NEGLIGIBLE * size or share < LEAST_GAIN:
            return count
    return min(len(curve), MOST_PARTS)


def part_moments(scene: Scene, labels: Int[np.ndarray, "V"], count: int) -> Moments:
    """The moments of `count` parts, vertices weighted by area; a negative label is no part."""
    return group_moments(membership(labels, scene.surface.areas, count), scene.rest, scene.paths)


def _merge_patches(scene: Scene, count: int) -> tuple[np.ndarray, Merging, Scene]:
    """Small patches, how they merge, and the scene with its rest mesh the mean over frames of
    the patches carried back, free of what is peculiar to the one mesh it started as."""
    patches = cut_patches(scene.surface, scene.rest, count)
    number = patches.max() + 1
    rotations, translations = rigid_motions(part_moments(scene, patches, number))
    scene = scene._replace(rest=_carried_back(scene, patches, rotations, translations))
    moments = part_moments(scene, patches, number)
    return patches, agglomerate(moments, label_edges(scene.surface, patches)[0]), scene


def _improve(scene: Scene, labels: np.ndarray, count: int) -> np.ndarray:
    """K-means, then one split and one merge at a time as long as both together lower the error."""
    labels, moments = _refine(scene, labels, count)
    splits: dict[bytes, tuple[float, np.ndarray]] = {}
    for _ in range(2 * count if count > 2 else 0):
        errors = rigid_errors(moments)
        found = [_split(scene, labels, part, splits) for part in range(count)]
        pairs = np.unique(label_edges(scene.surface, labels)[0], axis=0)
        a, b = pairs.T
        costs = rigid_errors(moments.at(a).plus(moments.at(b))) - errors[a] - errors[b]
        change = costs[:, None] - np.array([gain for gain, _ in found])
        change[np.arange(len(pairs)), a] = change[np.arange(len(pairs)), b] = np.inf
        best, part = np.unravel_index(np.argmin(change), change.shape)
        if change[best, part] > -SETTLED * errors.sum():
            break
        tried = np.where(labels == b[best], a[best], labels)
        tried[found[part][1]] = b[best]
        tried, moved = _refine(scene, tried, count)
        if rigid_errors(moved).sum() > (1 - SETTLED) * errors.sum():
            break
        labels, moments = tried, moved
    return labels


def _split(scene: Scene, labels: np.ndarray, part: int, known: dict) -> tuple[float, np.ndarray]:
    """The fall of the error when a part becomes two, and the vertices of one of them."""
    own = np.flatnonzero(labels == part)
    key = own.tobytes()
    if key not in known:
        patches = cut_patches(scene.surface, scene.rest, SPLIT_PATCHES, own)
        if patches.max() < 1:
            known[key] = 0.0, own[:0]
        else:
            moments = part_moments(scene, patches, patches.max() + 1)
            merging = agglomerate(moments, label_edges(scene.surface, patches)[0])
            halves = merged_labels(merging, 2)[patches[own]]
            known[key] = float(merging.errors[0] - merging.errors[1]), own[halves == 1]
    return known[key]


def _refine(scene: Scene, labels: np.ndarray, count: int) -> tuple[np.ndarray, Moments]:
    """Vertices go to the part that moves them best, parts move as their vertices do (Le and Deng
    2012), parts staying connected, until nearly nothing changes. The best labels met and their moments."""
    ring = adjacency(scene.surface)
    degree = np.asarray(ring.sum(1))
    best, best_moments, least = labels, part_moments(scene, labels, count), np.inf
    for _ in range(ROUNDS):
        moments = part_moments(scene, labels, count)
        error = rigid_errors(moments).sum()
        if error < least:
            done = error > (1 - SETTLED / 10) * least
            best, best_moments, least = labels, moments, error
            if done:
                break
        else:
            break
        costs = part_costs(scene, *rigid_motions(moments))
        # a vertex and its neighbours decide together, which keeps the borders short
        smooth = 0.5 * costs + 0.5 * (ring @ costs) / np.maximum(degree, 1)
        labels = connect(scene.surface, np.argmin(smooth, axis=1), smooth)
        if len(np.unique(labels)) < count:
            break
    return best, best_moments


def part_costs(
    scene: Scene, rotations: Float[np.ndarray, "K F 3 3"], translations: Float[np.ndarray, "K F 3"]
) -> Float[np.ndarray, "V K"]:
    """Squared distances, summed over frames, of every vertex to where each part would take it from
    the rest position that suits it best there."""
    frames = scene.paths.shape[1]
    flat = scene.paths.reshape(len(scene.paths), -1)
    sums = _sums_back(flat, rotations, translations)
    squares = np.einsum("vi,vi->v", flat, flat)[:, None] + np.sum(translations**2, (1, 2))
    squares = squares - 2 * flat @ translations.reshape(len(translations), -1).T
    return np.maximum(squares - np.sum(sums * sums, -1) / frames, 0.0)


def _carried_back(
    scene: Scene, labels: np.ndarray, rotations: np.ndarray, translations: np.ndarray
) -> Float[np.ndarray, "V 3"]:
    """The mean over frames of every vertex carried back by its part."""
    frames = scene.paths.shape[1]
    back = np.zeros_like(scene.rest)
    for part in range(len(rotations)):
        own = labels == part
        flat = scene.paths[own].reshape(-1, 3 * frames)
        back[own] = _sums_back(flat, rotations[part : part + 1], translations[part : part + 1])[:, 0] / frames
    return back


def _sums_back(flat: np.ndarray, rotations: np.ndarray, translations: np.ndarray) -> np.ndarray:
    """(V, K, 3) sums over frames of `R^T (x - t)`."""
    count = len(rotations)
    columns = rotations.reshape(count, -1, 3).transpose(1, 0, 2).reshape(-1, 3 * count)
    shift = np.einsum("kfab,kfa->kb", rotations, translations)
    return (flat @ columns).reshape(-1, count, 3) - shift


def _check(meshes: np.ndarray, faces: np.ndarray, count: int | None) -> None:
    if len(meshes) < 2:
        raise ValueError("Rigid parts show only in motion: at least two meshes are needed, one was given.")
    if not np.isfinite(meshes).all():
        frame = int(np.flatnonzero(~np.isfinite(meshes).all((1, 2)))[0])
        raise ValueError(f"Mesh {frame} holds a number that is not finite.")
    if faces.size == 0 or faces.min() < 0 or faces.max() >= meshes.shape[1]:
        raise ValueError(
            f"The faces have to name vertices 0 to {meshes.shape[1] - 1}, and there has to be one."
        )
    if count is not None and count < 1:
        raise ValueError(f"A body has at least one part; {count} were asked for.")
