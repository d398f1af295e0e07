"""Registration of the template to a surface by closest points in both directions, new in every step."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from ..body.body import Posed
from ..body.pose import Pose, rest_pose
from ..fit.alternate import anneal_problem
from ..fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ..geometry import rotation
from ..geometry.mesh import area_normals, vertex_areas
from .template import Build, Person, Template, average_build, pose_template
from .template_problem import TemplateProblem

#: distance equivalent to a unit difference of normals, metres; opposite normals differ by two
NORMAL_SCALE = 0.1
#: number of points sampled on the surface
SAMPLES = 4000
#: number of starts around the vertical
HEADINGS = 8
#: weight of tangential distances relative to normal ones
TANGENTIAL_WEIGHT = 0.1
#: standard deviation of the best fit, metres
NOISE = 0.015
#: number of independent distances for which a surface counts against the prior
EVIDENCE = 300.0
#: scales of the robust weight in each step, metres: for every start, for the finalists, for the best
COARSE = tuple(np.geomspace(0.25, 0.1, 6))
FINE = tuple(np.geomspace(0.12, 0.06, 8))
POLISH = tuple(np.geomspace(0.08, 0.03, 10)) + (0.03,) * 6
#: number of refined starts
FINALISTS = 2
#: damping of the first step, in units of the prior's deviations
DAMPING = 0.1
#: distance at which closest points are clipped in the residual, metres
CLIP_DISTANCE = 0.1


class SurfaceSamples(NamedTuple):
    """Points sampled uniformly on a surface, with unit normals and barycentric coordinates."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    corners: Int[np.ndarray, "N 3"]
    barycentric: Float[np.ndarray, "N 3"]


class Registration(NamedTuple):
    """A person of the template, and its fit."""

    person: Person
    #: the logarithm of the size from the surface's height, which is the prior's mean
    log_size: float
    #: the mean over both surfaces of the distance to the closest point with a similar normal, metres
    residual: float


def make_surface_samples(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int = SAMPLES
) -> SurfaceSamples:
    """Sample random points on a surface, the same in every call."""
    across = area_normals(vertices[faces])
    areas = np.linalg.norm(across, axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    shares = rng.dirichlet(np.ones(3), count)
    corners = faces[chosen]
    points = np.einsum("nc,nca->na", shares, vertices[corners])
    return SurfaceSamples(points, across[chosen] / areas[chosen, None], corners, shares)


def search_tree(points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> cKDTree:
    """Build the search tree of `find_closest`."""
    return cKDTree(_features(points, normals))


def find_closest(
    tree: cKDTree, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], count: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Find the distances (metres, including differences of normals) and indices of the closest points."""
    return tree.query(_features(points, normals), count)


def register(template: Template, surface: SurfaceSamples) -> Registration:
    """Register the template's build and pose to an upright person, y up, about in A-pose and of adult size.

    The heading is unknown: `HEADINGS` starts around the vertical are fitted coarsely, and the best
    `FINALISTS` of them finely. Distances have Geman-McClure weights with a decreasing scale. Build and pose
    have normal priors around the average build at rest. The module's lengths are for an adult's size.
    """
    search = search_tree(surface.points, surface.normals)
    starts = [_start(template, surface, 2 * np.pi * i / HEADINGS) for i in range(HEADINGS)]
    coarse = [_refine(template, surface, search, start, COARSE) for start in starts]
    coarse.sort(key=lambda found: found.residual)
    fine = [_refine(template, surface, search, found, FINE) for found in coarse[:FINALISTS]]
    return _refine(template, surface, search, min(fine, key=lambda found: found.residual), POLISH)


def _start(template: Template, surface: SurfaceSamples, heading: float) -> Registration:
    """Place the template at the surface's size and centre, with a heading about the vertical."""
    low, high = surface.points.min(0), surface.points.max(0)
    rest = np.asarray(template.body.vertices)
    size = (high[1] - low[1]) / np.ptp(rest[:, 1])
    build = average_build(template)
    build = Build(jnp.asarray(np.log(size), build.size.dtype), build.components, build.lengths, build.girths)
    pose = rest_pose(template.body.skeleton)
    turn = rotation.about_axis(jnp.array([0.0, 1.0, 0.0], rest.dtype), jnp.asarray(heading, rest.dtype))
    root = np.asarray(template.body.skeleton.centres[0])
    # the root is central in the body; its height above the soles scales with the size
    place = np.median(surface.points, axis=0)
    place[1] = low[1] + size * (root[1] - rest[:, 1].min())
    shift = jnp.asarray(place - size * root, rest.dtype)
    pose = Pose(pose.translations.at[0].set(shift), pose.rotations.at[0].set(turn), pose.scale)
    return Registration(Person(build, pose), np.log(size), np.inf)


def _refine(
    template: Template,
    surface: SurfaceSamples,
    search: cKDTree,
    start: Registration,
    scales: tuple[float, ...],
) -> Registration:
    """Take a step with new closest points at each of the scales."""
    body = template.body
    areas = vertex_areas(np.asarray(body.vertices, float), np.asarray(body.faces))

    def remake(person: Person, scale: float) -> TemplateProblem:
        posed = pose_template(template, person)
        parts = *_quadratic_energy(posed, areas, surface, search, scale), start.log_size
        return TemplateProblem(
            template, posed.vertices, *(jnp.asarray(part, posed.vertices.dtype) for part in parts)
        )

    person = anneal_problem(remake, start.person, LevenbergMarquardt(damping=DAMPING), scales)
    residual = _residual(pose_template(template, person), areas, surface, search)
    return Registration(person, start.log_size, residual)


def _quadratic_energy(
    posed: Posed, areas: np.ndarray, surface: SurfaceSamples, search: cKDTree, scale: float
) -> tuple[Float[np.ndarray, "V 3 3"], Float[np.ndarray, "V 3"], float]:
    """Compute the quadratic energy of every vertex about its position, `d' A d - 2 b' d`, and the constant.

    It sums a vertex's closest point on the surface and all points of the surface whose closest vertex it is.
    """
    vertices, normals = np.asarray(posed.vertices, float), np.asarray(posed.normals, float)
    _, nearest = find_closest(search, vertices, normals)
    _, owner = find_closest(search_tree(vertices, normals), surface.points, surface.normals)
    source = np.concatenate([np.arange(len(vertices)), owner])
    target = np.concatenate([nearest, np.arange(len(surface.points))])
    share = np.concatenate([areas / areas.sum(), np.full(len(owner), 1 / len(owner))])
    gap = surface.points[target] - vertices[source]
    n = surface.normals[target]
    agreement = np.maximum(np.sum(n * normals[source], axis=1), 0.0)
    robust = (scale**2 / (scale**2 + np.sum(gap * gap, axis=1))) ** 2
    weight = 0.5 * EVIDENCE / (NOISE**2 + scale**2 / 4) * share * agreement * robust
    local = weight[:, None, None] * (n[:, :, None] * n[:, None, :] + TANGENTIAL_WEIGHT * np.eye(3))
    matrices, pulls = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    np.add.at(matrices, source, local)
    pulled = np.einsum("nab,nb->na", local, gap)
    np.add.at(pulls, source, pulled)
    return matrices, pulls, float(np.sum(gap * pulled))


def _residual(posed: Posed, areas: np.ndarray, surface: SurfaceSamples, search: cKDTree) -> float:
    vertices, normals = np.asarray(posed.vertices, float), np.asarray(posed.normals, float)
    distances, _ = find_closest(search, vertices, normals)
    back, _ = find_closest(search_tree(vertices, normals), surface.points, surface.normals)
    return float(
        0.5 * np.average(np.minimum(distances, CLIP_DISTANCE), weights=areas)
        + 0.5 * np.minimum(back, CLIP_DISTANCE).mean()
    )


def _features(points: np.ndarray, normals: np.ndarray) -> Float[np.ndarray, "N 6"]:
    """Combine points and scaled normals in one feature vector for the search."""
    return np.concatenate([points, NORMAL_SCALE * normals], axis=1)
