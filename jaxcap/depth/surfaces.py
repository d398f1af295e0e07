"""Connected surfaces in a depth image."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

#: image size for the search, pixels on the longest side
SEARCH_SIDE = 160
#: neighbouring pixels are on one surface if their depths differ by less than this share of the depth
CONTINUITY = 0.04


def search_step(shape: tuple[int, ...]) -> int:
    """Return the number of rows and columns from one searched pixel to the next."""
    return max(1, -(-max(shape) // SEARCH_SIDE))


def connect_pixels(z: Float[np.ndarray, "h w"], free: Bool[np.ndarray, "h w"]) -> Int[np.ndarray, "h w"]:
    """Label connected `free` pixels with continuous depths, from 1; zero for others."""
    index = np.arange(z.size).reshape(z.shape)
    links = []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        near = free[a] & free[b] & (np.abs(z[a] - z[b]) < CONTINUITY * np.minimum(z[a], z[b]))
        links.append(np.stack([index[a][near], index[b][near]], 1))
    i, j = np.concatenate(links).T
    _, of = connected_components(coo_array((np.ones(len(i)), (i, j)), shape=(z.size, z.size)), directed=False)
    labels = np.zeros(z.size, int)
    _, labels[free.reshape(-1)] = np.unique(of[free.reshape(-1)], return_inverse=True)
    labels[free.reshape(-1)] += 1
    return labels.reshape(z.shape)
