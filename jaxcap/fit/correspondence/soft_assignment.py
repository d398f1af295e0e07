"""Soft assignment of a scan's points to a body's vertices by a mixture of Gaussians, and the reverse."""

from typing import Literal

import numpy as np
import scipy.sparse
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from .nearest_assignment import AbstractAssignment, Assignment, IndexedScan, PosedSurface

#: log of the density relative to the outlier class's below which it counts as zero
NEGLIGIBLE = np.log(1e-7)
#: points assigned at once, which bounds memory
CHUNK = 4096


class SoftAssignment(AbstractAssignment):
    """Gaussian soft assignment, as in the tracker's E-step but to vertices instead of parts.

    A point comes from

        p(y) = (1 - w) / M sum_v N(y; x_v, sigma^2 I) + w / B,

    the sum over the M visible vertices, without those with another normal or out of reach (Kineben, eqs. 20
    and 21; Myronenko and Song 2010). `w` is the share `outlier`, `B` the volume of the box around all points.
    With `p_nv` the posterior of vertex v at point n, the M-step's sum is

        sum_nv p_nv |x_v - y_n|^2 = sum_v P_v |x_v - m_v|^2 + const,
        P_v = sum_n p_nv,    m_v = sum_n p_nv y_n / P_v,

    so that one pair per vertex, of the posterior mean `m_v` with the mass `P_v` as its weight, represents the
    whole scan, in any metric that is the same for all points of a vertex. The mass may be more than one, as
    where a scan is denser than a body; these weights are those of all points together.

    From the body to the scan the roles are exchanged: vertices are explained, with their own box, and `Q_v =
    sum_n q_vn`, at most one, is the weight of `sum_n q_vn y_n / Q_v`.

    The outlier class rejects points, so that no mean is left out for its distance. A mean lies within a
    curved surface by about `sigma^2` times its mean curvature: lower `sigma` as poses improve.

    Without outliers all points within reach are weighted, which takes longer. As `sigma` goes to zero, every
    point is assigned to the nearest vertex with a similar normal.
    """

    #: standard deviation of a point from its vertex along each axis, metres
    sigma: float = 0.01
    #: share of points that nothing explains
    outlier: float = 0.1

    def __check_init__(self):
        if not (np.isfinite(self.sigma) and self.sigma > 0):
            raise ValueError(f"`sigma` is {self.sigma}; expected a finite standard deviation above 0.")
        if not 0 <= self.outlier < 1:
            raise ValueError(f"`outlier` is {self.outlier}; expected a share of at least 0 and below 1.")

    def from_scan(self, surface, scan, max_distance, normal_threshold):
        chosen = np.flatnonzero(surface.visible)
        body = surface.vertices[chosen], surface.normals[chosen]
        shares = self._posterior((scan.points, scan.normals), body, max_distance, normal_threshold)
        return _means(surface, scan, chosen, scipy.sparse.csr_array(shares.T), "mean")

    def from_body(self, surface, scan, max_distance, normal_threshold):
        chosen = np.flatnonzero(surface.visible)
        body = surface.vertices[chosen], surface.normals[chosen]
        shares = self._posterior(body, (scan.points, scan.normals), max_distance, normal_threshold)
        return _means(surface, scan, chosen, shares, "vertex")

    def _posterior(
        self, explained, means, max_distance: float, normal_threshold: float
    ) -> scipy.sparse.csr_array:
        """Compute the posterior `(N, M)` of N points explained by M means; each are positions and normals."""
        (points, normals), (centres, centre_normals) = explained, means
        if not (len(points) and len(centres)):
            return scipy.sparse.csr_array((len(points), len(centres)))
        highest = np.log((1 - self.outlier) / len(centres)) - 1.5 * np.log(2 * np.pi * self.sigma**2)
        outlier_density = -np.inf
        if self.outlier > 0:
            outlier_density = np.log(self.outlier / max(np.prod(np.ptp(points, 0)), 1e-6))
            max_distance = min(
                max_distance, self.sigma * np.sqrt(2 * max(highest - outlier_density - NEGLIGIBLE, 0.0))
            )
        tree, rows = KDTree(centres), []
        for start in range(0, len(points), CHUNK):
            own = slice(start, start + CHUNK)
            near = KDTree(points[own]).sparse_distance_matrix(tree, max_distance, output_type="ndarray")
            row, column = near["i"], near["j"]
            good = np.einsum("pa,pa->p", normals[own][row], centre_normals[column]) >= normal_threshold
            row, column, distances = row[good], column[good], near["v"][good]
            shares = _posterior_shares(
                row, highest - 0.5 * (distances / self.sigma) ** 2, outlier_density, len(points[own])
            )
            shape = (len(points[own]), len(centres))
            rows.append(scipy.sparse.csr_array((shares, (row, column)), shape=shape))
        return scipy.sparse.csr_array(scipy.sparse.vstack(rows, format="csr"))


def _posterior_shares(
    row: Int[np.ndarray, "P"], log: Float[np.ndarray, "P"], log_outlier: float, count: int
) -> Float[np.ndarray, "P"]:
    """Compute posteriors from log densities; those of one row and the outlier class add up to one."""
    top = np.full(count, log_outlier)
    np.maximum.at(top, row, log)
    unscaled = np.exp(log - top[row])
    # a row without densities, and without an outlier class, has no posterior
    outlier = np.exp(log_outlier - np.where(np.isfinite(top), top, 0.0))
    total = np.bincount(row, unscaled, count) + outlier
    return unscaled / total[row]


def _means(
    surface: PosedSurface,
    scan: IndexedScan,
    chosen: Int[np.ndarray, "M"],
    shares: scipy.sparse.csr_array,
    row_type: Literal["vertex", "mean"],
) -> Assignment:
    """Match every vertex with the mean of its shares `(M, N)` of a scan's points; the mass is their sum."""
    every = np.arange(len(surface.vertices))[:, None]
    mass, normals = np.zeros(len(every)), np.zeros((len(every), 3))
    points = surface.vertices.copy()
    mass[chosen] = shares.sum(1)
    safe = np.where(mass > 0, mass, 1.0)[chosen, None]
    points[chosen] = np.where(mass[chosen, None] > 0, shares @ scan.points / safe, points[chosen])
    normals[chosen] = shares @ scan.normals / safe
    return Assignment(every, np.ones(every.shape), points, normals, mass, row_type)
