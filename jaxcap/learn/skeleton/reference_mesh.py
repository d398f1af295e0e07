"""Choice of the reference mesh."""

import numpy as np
from jaxtyping import Float, Int

from ...geometry.procrustes import group_moments, nearest_rotation, rigid_motions
from ...geometry.sampling import even_indices
from ..parts.surface_graph import cut_patches, make_surface_graph, membership

#: the number of patches whose rotations are compared
PATCHES = 100
#: the most meshes that are compared with each other
FRAMES = 200


def choose_reference_mesh(meshes: Float[np.ndarray, "F V 3"], faces: Int[np.ndarray, "T 3"]) -> int:
    """Return the index of the mesh nearest to all others: the medoid of the poses.

    The distance of two meshes is the root mean square rotation between their small patches, weighted by area,
    after the rotation of the whole body is removed.
    """
    meshes = np.asarray(meshes)
    chosen = even_indices(len(meshes), FRAMES, nearest=True)
    first = np.asarray(meshes[0], float)
    surface = make_surface_graph(first, meshes, np.asarray(faces))
    patches = cut_patches(surface, first, PATCHES)
    groups = membership(patches, surface.areas, int(patches.max()) + 1)
    paths = np.ascontiguousarray(meshes[chosen].transpose(1, 0, 2), float)
    turns, _ = rigid_motions(group_moments(groups, first, paths - paths.mean(0)))
    weights = np.asarray(groups.sum(1)).ravel()
    # residual of the best common rotation of all patches from one mesh to another
    residuals = np.zeros((len(chosen), len(chosen)))
    weighted = weights[:, None, None, None] * turns
    for frame in range(len(chosen)):
        change = np.einsum("pab,pfcb->fac", weighted[:, frame], turns)
        agreement = np.einsum("fab,fab->f", nearest_rotation(change), change)
        residuals[frame] = np.sqrt(np.maximum(3 * weights.sum() - agreement, 0.0))
    return int(chosen[np.argmin(residuals.sum(1))])
