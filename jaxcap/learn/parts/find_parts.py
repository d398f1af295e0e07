"""Segmentation of a moving surface into rigid parts, with their motions."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...geometry.mesh import box_diagonal
from ...geometry.procrustes import rigid_errors, rigid_motions
from ..skeleton.reference_mesh import choose_reference_mesh
from ..symmetry.surface_symmetry import SurfaceSymmetry
from .agglomerate import Dendrogram, agglomerate, merged_labels
from .part_kmeans import improve_parts, refine_patch_borders
from .rigid_residuals import MovingSurface, mean_rest_positions, part_moments
from .ssdr_motions import estimate_bone_motions
from .surface_graph import boundary_edges, cut_patches, make_surface_graph
from .symmetric_parts import SymmetricParts, improve_symmetric_parts

#: the number of patches that are merged into parts
PATCHES = 300
#: one more part has to lower the root mean square error by this share
MIN_GAIN = 0.024
#: the largest share by which parts in pairs may raise the error
MAX_SYMMETRY_COST = 0.01
#: share of the body's diagonal below which an error is negligible
NEGLIGIBLE = 2e-4
#: the most parts when the number is chosen automatically
MAX_PARTS = 60


class RigidParts(NamedTuple):
    """K rigid parts of V vertices in F frames.

    Part `k` moves vertex `p` to `rotations[f, k] p + translations[f, k]`, metres. The motions are those of
    bones under a skin: around a joint, vertices move as blends of two parts.
    """

    labels: Int[np.ndarray, "V"]
    rotations: Float[np.ndarray, "F K 3 3"]
    translations: Float[np.ndarray, "F K 3"]
    #: rest positions that best fit all frames, in the pose of the given rest mesh
    rest: Float[np.ndarray, "V 3"]
    #: (N,) root mean square error in metres with 1, 2, ... N parts, before they are refined
    curve: Float[np.ndarray, "N"]
    #: root mean square distance of the vertices from their rigid parts, weighted by area, metres
    error: float
    #: the adjacent part with which a vertex is blended, and the weight of its own part in the blend, 0 to 1
    partners: Int[np.ndarray, "V"]
    shares: Float[np.ndarray, "V"]
    #: the share by which parts in pairs raise the error; 0 without a symmetry
    symmetry_cost: float = 0.0

    @property
    def num_parts(self) -> int:
        """K, the number of parts."""
        return self.rotations.shape[1]


def find_parts(
    meshes: Float[np.ndarray, "F V 3"],
    faces: Int[np.ndarray, "T 3"],
    num_parts: int | None = None,
    rest: Float[np.ndarray, "V 3"] | None = None,
    symmetry: SurfaceSymmetry | None = None,
    max_symmetry_cost: float = MAX_SYMMETRY_COST,
) -> RigidParts:
    """Segment a surface into connected parts that move as rigidly as possible.

    Some hundred small patches are merged by least rigid error, which gives the error over the number of
    parts. The parts are then refined by k-means with rigid motions (Le and Deng 2012), and by moves that
    split one part and drop another if that lowers the error of blended vertices. Finally, motions are
    estimated under blending (`estimate_bone_motions`). Each vertex is weighted by its area.

    **Arguments:** `meshes` in one topology, metres; `faces` are triangles; `num_parts` is the number of parts, by
    default as many as each lower the error by `MIN_GAIN`; `rest` is the mesh in whose pose the parts rest,
    by default the one nearest to all others (`choose_reference_mesh`). With a `symmetry` of the surface, parts are on the
    middle or mirror each other, unless that raises the error by a larger share than `max_symmetry_cost`.

    **Raises:** `ValueError` for fewer than two meshes, numbers that are not finite, faces with invalid vertex
    indices, and a count that is not between one and the number of patches.
    """
    meshes, faces = np.asarray(meshes), np.asarray(faces)
    _check(meshes, faces, num_parts)
    if rest is None:
        rest = meshes[choose_reference_mesh(meshes, faces)]
    rest = np.asarray(rest, float)
    surface = make_surface_graph(rest, meshes, faces)
    paths = np.ascontiguousarray(meshes.transpose(1, 0, 2), float)
    middle, middles = surface.areas @ rest, np.einsum("v,vfa->fa", surface.areas, paths)
    scene = MovingSurface(surface, rest - middle, paths - middles)
    patches, merging, scene = _merge_patches(scene, PATCHES)
    curve = np.sqrt(merging.errors / len(meshes))
    is_fixed = num_parts is not None
    if num_parts is None:
        num_parts = choose_num_parts(curve, box_diagonal(rest))
    elif num_parts > len(curve):
        raise ValueError(
            f"The number of parts is {num_parts}; expected at most {len(curve)}, the number of "
            "patches of the surface."
        )

    def partition(number: int) -> Int[np.ndarray, "V"]:
        return merged_labels(merging, min(number, len(curve)))[patches]

    state, symmetry_cost = (
        SymmetricParts(improve_parts(scene, partition(num_parts), num_parts), 0.0)
        if symmetry is None
        else improve_symmetric_parts(
            scene, partition, num_parts, is_fixed, symmetry, MIN_GAIN, max_symmetry_cost
        )
    )
    labels, moved = state.labels, state.moments
    error = float(np.sqrt(rigid_errors(moved).sum() / len(meshes)))
    motions, mixed, back = estimate_bone_motions(scene, labels, state.motions)
    rotations, translations = motions.rotations, motions.translations
    # move the origin back to that of the world
    translations = translations + middles - np.einsum("kfab,b->kfa", rotations, middle)
    return RigidParts(
        labels,
        rotations.swapaxes(0, 1),
        translations.swapaxes(0, 1),
        back + middle,
        curve,
        error,
        mixed.partners,
        mixed.shares,
        symmetry_cost,
    )


def choose_num_parts(curve: Float[np.ndarray, "N"], size: float) -> int:
    """Choose the number of parts beyond which the error falls by less than `MIN_GAIN` per part.

    The gain is the mean of the next three parts. The search also ends where the error is negligible against
    the `size` of the body, metres.
    """
    for count in range(1, min(len(curve), MAX_PARTS)):
        ahead = min(count + 3, len(curve))
        share = 1 - (curve[ahead - 1] / max(curve[count - 1], 1e-300)) ** (1 / (ahead - count))
        if curve[count - 1] < NEGLIGIBLE * size or share < MIN_GAIN:
            return count
    return min(len(curve), MAX_PARTS)


def _merge_patches(scene: MovingSurface, count: int) -> tuple[np.ndarray, Dendrogram, MovingSurface]:
    """Cut the surface into patches and merge them.

    Returns the patches, their merges, and the scene with a rest mesh that is the mean over frames of the
    patches moved back to rest, without the peculiarities of the initial mesh.
    """
    patches = refine_patch_borders(scene, cut_patches(scene.surface, scene.rest, count))
    number = int(patches.max()) + 1
    rotations, translations = rigid_motions(part_moments(scene, patches, number))
    scene = scene._replace(rest=mean_rest_positions(scene, patches, rotations, translations))
    moments = part_moments(scene, patches, number)
    return patches, agglomerate(moments, boundary_edges(scene.surface, patches)[0]), scene


def _check(meshes: np.ndarray, faces: np.ndarray, count: int | None) -> None:
    if len(meshes) < 2:
        raise ValueError("There is no motion to find rigid parts from; expected at least two meshes.")
    if not np.isfinite(meshes).all():
        frame = int(np.flatnonzero(~np.isfinite(meshes).all((1, 2)))[0])
        raise ValueError(f"Mesh {frame} has vertices that are not finite.")
    if faces.size == 0 or faces.min() < 0 or faces.max() >= meshes.shape[1]:
        raise ValueError(
            "There are no faces, or their vertex indices are invalid; expected indices from 0 to "
            f"{meshes.shape[1] - 1}."
        )
    if count is not None and count < 1:
        raise ValueError(f"The number of parts is {count}; expected at least 1.")
