"""The left-right symmetry of registered meshes, found on the surface."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from threadpoolctl import threadpool_limits

from ...arguments import checked
from ...geometry.sampling import farthest_points
from ...observe.meshes import MeshSequence
from .accept_map import describe, objections, preference
from .coarse_surface import CoarseSurface, make_coarse_surface
from .extremities import Exchange, Extremities, find_extremities, list_exchanges
from .intrinsic_surface import geodesic_distances
from .involution import embeddings, refine_involution, smoothest_odd_function
from .judge_map import DistanceSamples, MapQuality, displacements, judge_map
from .point_map import PointMap, nearest_points, nearest_rows
from .spectral_basis import EIGENFUNCTIONS, SpectralBasis, make_spectral_basis, wave_kernel_signature
from .surface_symmetry import SurfaceSymmetry

#: vertices from which distances are measured
SAMPLES = 200
#: exchanges of extremities that are tried, and eigenfunctions of a trial
TRIALS, TRIAL_FUNCTIONS = 10, 60
#: another reflection is a rival if its deviation is within this factor; it is another one if images are farther from each other
#: than this share of the largest distance, on at least this share of the surface
RIVAL, DIFFERENT, DIFFERENT_SHARE = 1.3, 0.1, 0.3
#: a vertex is on the middle if it is this near to its image, as a share of the largest distance
MIDDLE = 0.04


class _Searched(NamedTuple):
    """The surface as the search sees it."""

    coarse: CoarseSurface
    basis: SpectralBasis
    signature: Float[np.ndarray, "V N"]
    samples: DistanceSamples
    extremities: Extremities


class _Refined(NamedTuple):
    """A refined map, its measures, and a function with opposite signs on the two sides."""

    points: PointMap
    quality: MapQuality
    odd: Float[np.ndarray, "V"]


@checked
def find_symmetry(meshes: MeshSequence) -> tuple[SurfaceSymmetry | None, str]:
    """Find the left-right symmetry of registered meshes from distances along the surface, in any poses.

    The symmetry exchanges extremities, keeps geodesic distances, reverses the orientation of the surface and is its own
    inverse. Edge lengths are means over the meshes. Exchanges of extremities that keep their distances (Kim et al. 2010) are
    refined as involutions between eigenfunctions of the Laplacian (Ovsjanikov, Sun and Guibas 2008), and the one that keeps
    distances best is judged.

    **Returns:** the symmetry, or None, and a sentence with its measures, or with the reason why none was found.
    """
    # small matrices: threads of BLAS would wait for each other
    with threadpool_limits(1, "blas"):
        coarse, problem = make_coarse_surface(meshes)
        found, sentence = (None, problem) if coarse is None else _search(_prepare(coarse))
    if coarse is None or found is None:
        return None, f"No left-right symmetry was found: {sentence}."
    rows = coarse.rows
    points = PointMap(coarse.kept[found.points.corners[rows]], found.points.weights[rows])
    return SurfaceSymmetry(*points, np.sign(found.odd).astype(int)[rows], found.quality), sentence


def _search(searched: _Searched) -> tuple[_Refined | None, str]:
    """Refine every exchange of extremities a little, and the best one to the end."""
    exchanges = list_exchanges(searched.extremities)[:TRIALS]
    if not exchanges:
        return None, (
            f"of {len(searched.extremities.vertices)} extremities of the surface, no two can be exchanged without a change of "
            "their distances along the surface"
        )
    trials = [_refine(searched, _first_images(searched, exchange), TRIAL_FUNCTIONS) for exchange in exchanges]
    trials.sort(key=lambda trial: preference(trial.quality))
    best = _refine(searched, trials[0].points.nearest, EIGENFUNCTIONS)
    rivals = [
        trial
        for trial in trials[1:]
        if not objections(trial.quality) and trial.quality.deviation < RIVAL * trials[0].quality.deviation
    ]
    reasons = objections(best.quality)
    if not reasons and any(_differ(searched, trials[0].points, rival.points) for rival in rivals):
        reasons = ["two different reflections keep distances along the surface about equally well"]
    if reasons:
        return None, "; ".join(reasons)
    middle = displacements(best.points, searched.samples) < MIDDLE * searched.samples.size
    return best._replace(odd=np.where(middle, 0.0, best.odd)), describe(best.quality)


def _differ(searched: _Searched, first: PointMap, second: PointMap) -> bool:
    """Test whether two maps send a large part of the surface to different places."""
    distances, size = searched.samples.distances.T, searched.samples.size
    away = np.abs(first.pull_back(distances) - second.pull_back(distances)).max(1)
    return bool(searched.basis.areas @ (away > DIFFERENT * size) > DIFFERENT_SHARE)


def _prepare(coarse: CoarseSurface) -> _Searched:
    """Compute eigenfunctions, distances and extremities."""
    surface = coarse.surface
    basis = make_spectral_basis(surface)
    spread = basis.functions[:, 1:9]
    sources = farthest_points(
        spread / np.maximum(spread.std(0), 1e-12), SAMPLES, int(np.argmax(np.abs(spread[:, 0])))
    )
    samples = DistanceSamples(sources, geodesic_distances(surface, sources))
    means = np.average(samples.distances, axis=0, weights=basis.areas[sources])
    extremities = find_extremities(surface, means, samples.size)
    return _Searched(coarse, basis, wave_kernel_signature(basis), samples, extremities)


def _first_images(searched: _Searched, exchange: Exchange) -> Int[np.ndarray, "V"]:
    """Map each vertex to the one that has its distances to the exchanged extremities, and its signature."""
    distances, shape = searched.extremities.distances.T, searched.signature
    unit = distances.std()
    rows = np.concatenate([distances / unit, shape], 1)
    queries = np.concatenate([distances[:, list(exchange.partners)] / unit, shape], 1)
    return nearest_rows(queries, rows)


def _refine(searched: _Searched, images: Int[np.ndarray, "V"], most: int) -> _Refined:
    """Refine a map with up to `most` eigenfunctions, and measure it."""
    surface, basis = searched.coarse.surface, searched.basis
    involution = refine_involution(basis, images, most)
    found = nearest_points(*embeddings(basis.functions[:, : len(involution)], involution), surface.faces)
    quality = judge_map(surface, basis, found, searched.samples)
    return _Refined(found, quality, smoothest_odd_function(basis, involution))
