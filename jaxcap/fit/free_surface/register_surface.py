"""Registration of a surface with free vertices to a scan, near the surface that guides it."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from ...arguments import checked
from ...energy.data.pairs import PointPairs, pair_positions
from ...geometry.mesh import vertex_normals
from ..alternate import anneal_problem
from ..correspondence.find_pairs import Matching, find_pairs
from ..correspondence.nearest_assignment import IndexedScan, NearestOnSurface
from ..linear_solvers.regularised_blocks import PrecisionRoot
from ..solvers.levenberg_marquardt import LevenbergMarquardt
from .free_surface_problem import FreeSurfaceProblem
from .vertex_couplings import find_couplings

#: largest distance of a pair in each round, metres
REACHES = (0.05, 0.05, 0.04, 0.03, 0.03, 0.03)
#: largest angle between the two normals of a pair, degrees
MAX_NORMAL_ANGLE = 60.0
#: least and largest estimated standard deviation of the surface from its guide, metres: with a larger one, vertices of a
#: poor guide wander along the surface
MIN_DEVIATION, MAX_DEVIATION = 5e-4, 0.01
#: least standard deviation of points across the surface, metres
MIN_SIGMA = 5e-4
#: number of standard deviations at which the weight of a pair is a half (Cauchy)
ROBUST_SCALE = 3.0
#: weight of a vertex's pair relative to that of a point: its point has a pair already
VERTEX_WEIGHT = 0.25
#: angle between the surface and the plane of a vertex's nearest point, from curvature and noisy normals, radians: the
#: distance from the plane is uncertain by this times the distance along it
PLANE_ANGLE = 0.2
#: weight of squared distances along the surface relative to those across it: points slide in their tangent planes
TANGENTIAL_WEIGHT = 0.001
#: a vertex is seen if its nearest point is within the distance of a point from its neighbour of this rank
SPACING_RANK = 6
#: residual at which conjugate gradients end, and damping of a step, as a share of each curvature
TOLERANCE, DAMPING = 1e-4, 1e-6
#: of a normal distribution, standard deviation over median distance
_OF_MEDIAN = 1.4826


class SurfaceRegistration(NamedTuple):
    """A surface registered to a scan."""

    #: metres
    vertices: Float[np.ndarray, "V 3"]
    #: true where the scan has points near the vertex, with similar normals
    seen: Bool[np.ndarray, "V"]
    #: distance of a seen vertex from the scan, across the surface, metres; NaN elsewhere
    distances: Float[np.ndarray, "V"]
    #: share of the scan's points that have a pair
    explained: float
    #: standard deviation of these points across the surface, metres
    sigma: float


@checked
def register_surface(
    guide: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    scan: IndexedScan,
    prior: PrecisionRoot,
    visible: Bool[np.ndarray, "V"] | None = None,
) -> SurfaceRegistration:
    """Move the vertices of a surface freely to a scan, smoothly with respect to the surface that guides them.

    In rounds of decreasing reach, every point of the scan is paired with its nearest point of the surface, and every
    vertex with its nearest point of the scan, if the normals are similar. The displacements that minimise the squared
    distances across the surface and the prior's energy are then the solution of one sparse linear system. Points are
    weighted by their standard deviation, which is estimated in each round, and robustly (Cauchy).
    Vertices without points keep near the guide.

    **Arguments:** `guide`, positions of the vertices, metres; `prior` of `make_displacement_prior`; `visible`, vertices
    that some camera sees: the others are not matched.
    """
    spacing = _point_spacing(scan)
    start = jnp.zeros(guide.shape)

    def make_problem(displacement, reach: float) -> FreeSurfaceProblem:
        found = _find_pairs(guide + np.asarray(displacement, float), faces, scan, spacing, visible, reach)
        return FreeSurfaceProblem(
            jnp.asarray(guide, float),
            found.pairs,
            find_couplings(faces, len(guide), found.pairs),
            prior,
            jnp.asarray(TOLERANCE, float),
        )

    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=DAMPING, relative=True)
    displacement = anneal_problem(make_problem, start, solver, REACHES)
    vertices = guide + np.asarray(displacement, float)
    last = _find_pairs(vertices, faces, scan, spacing, visible, REACHES[-1])
    return SurfaceRegistration(vertices, last.seen, last.distances, last.explained, last.sigma)


def estimate_deviation(
    guide: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    scan: IndexedScan,
    visible: Bool[np.ndarray, "V"] | None = None,
) -> float:
    """Estimate the standard deviation of the scanned surface from its guide, across the surface, metres.

    The noise of neighbouring points is independent, but their distances from the guide are alike. The mean product of
    these is therefore the variance without the noise: the covariance function near zero, as opposed to at zero
    (Matheron 1963). It is from `MIN_DEVIATION` to `MAX_DEVIATION`.
    """
    found = _find_pairs(guide, faces, scan, _point_spacing(scan), visible, REACHES[0])
    # padding comes last
    count = len(scan.points)
    across, paired = found.across[:count], np.asarray(found.pairs.weights)[:count] > 0
    if count < 2 or not paired.any():
        return MIN_DEVIATION
    _, neighbours = scan.tree.query(scan.points, [2], workers=-1)
    both = paired & paired[neighbours[:, 0]]
    products = across[both] * across[neighbours[both, 0]]
    return float(
        np.sqrt(max(products.mean(), 0.0) if len(products) else 0.0).clip(MIN_DEVIATION, MAX_DEVIATION)
    )


class _Pairs(NamedTuple):
    pairs: PointPairs
    seen: Bool[np.ndarray, "V"]
    distances: Float[np.ndarray, "V"]
    explained: float
    sigma: float
    #: signed distance of each pair across the surface, metres
    across: Float[np.ndarray, "C"]


def _find_pairs(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    scan: IndexedScan,
    spacing: Float[np.ndarray, "N"],
    visible: Bool[np.ndarray, "V"] | None,
    reach: float,
) -> _Pairs:
    """Pair a surface with a scan in both directions, weighted by the inverse variance of points."""
    count = len(vertices)
    matching = Matching(
        max_normal_angle=MAX_NORMAL_ANGLE,
        max_distance=reach,
        uniform=False,
        charbonnier=reach,
        tangential_weight=TANGENTIAL_WEIGHT,
        assignment=NearestOnSurface(),
    )
    normals = np.asarray(vertex_normals(vertices, faces))
    pairs = find_pairs(vertices, normals, faces, scan, matching, visible)
    gaps = np.asarray(pair_positions(pairs, jnp.asarray(vertices, float)), float) - np.asarray(pairs.points)
    across = np.sum(gaps * np.asarray(pairs.normals), 1)
    along = np.sqrt(np.maximum(np.sum(gaps**2, 1) - across**2, 0.0))
    weights = np.array(pairs.weights, float)
    # beyond the border of a partial scan the nearest point lies to the side
    weights[-count:] *= along[-count:] <= _spacing_at(vertices, scan, spacing)
    from_scan, seen = weights[:-count] > 0, weights[-count:] > 0
    sigma = MIN_SIGMA
    if from_scan.any():
        sigma = max(_OF_MEDIAN * float(np.median(np.abs(across[:-count][from_scan]))), sigma)
    variances = np.full(len(weights), sigma**2)
    variances[-count:] += (PLANE_ANGLE * along[-count:]) ** 2
    # zero or one: robust weights are of distances across the surface
    weights = (weights > 0) / (variances + (across / ROBUST_SCALE) ** 2)
    weights[-count:] *= VERTEX_WEIGHT
    pairs = eqx.tree_at(lambda p: p.weights, pairs, jnp.asarray(weights, pairs.weights.dtype))
    distances = np.where(seen, np.abs(across[-count:]), np.nan)
    return _Pairs(pairs, seen, distances, float(from_scan.sum()) / len(scan.points), sigma, across)


def _point_spacing(scan: IndexedScan) -> Float[np.ndarray, "N"]:
    """Compute the distance of each point from its neighbour of rank `SPACING_RANK`, at least the median one."""
    rank = min(SPACING_RANK + 1, len(scan.points))
    distances, _ = scan.tree.query(scan.points, [rank], workers=-1)
    return np.maximum(distances[:, 0], np.median(distances))


def _spacing_at(
    vertices: Float[np.ndarray, "V 3"], scan: IndexedScan, spacing: Float[np.ndarray, "N"]
) -> Float[np.ndarray, "V"]:
    """Compute the spacing of the scan's points around each vertex."""
    _, nearest = scan.tree.query(vertices, workers=-1)
    return spacing[nearest]
