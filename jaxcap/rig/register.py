"""Registration of the template to a surface: closest points both ways, found anew in every round."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]

from ..body.body import Posed
from ..body.pose import Pose, rest_pose
from ..fit.alternate import anneal
from ..fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ..geometry import rotation
from .heat import face_vectors
from .problem import TemplateProblem
from .template import Build, Person, Template, average_build, pose_template

#: metres that count as much as one unit between normals, of which two are opposite
NORMAL_SCALE = 0.1
#: points sampled on the surface
SAMPLES = 4000
#: starts around the vertical
HEADINGS = 8
#: weight of distances along the surface against those across it
SLIDE = 0.1
#: metres; what a surface fits to at best
NOISE = 0.015
#: how many independent distances a surface is worth against the prior
EVIDENCE = 300.0
#: scale (metres) of the robust weight in each step: for every start, for the finalists, for the best
COARSE = tuple(np.geomspace(0.25, 0.1, 6))
FINE = tuple(np.geomspace(0.12, 0.06, 8))
POLISH = tuple(np.geomspace(0.08, 0.03, 10)) + (0.03,) * 6
#: starts that are refined
FINALISTS = 2
#: of the first step, by the prior's deviations
DAMPING = 0.1
#: metres; closest points are cut off here in the residual
CUT = 0.1


class Surface(NamedTuple):
    """Points spread evenly over a surface, its unit normals there, and where in its triangles they lie."""

    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"]
    corners: Int[np.ndarray, "N 3"]
    shares: Float[np.ndarray, "N 3"]


class Registration(NamedTuple):
    """A person of the template, and how well it fits."""

    person: Person
    #: the logarithm of the size by the height of the surface, about which the prior holds the build's
    size: float
    #: the mean over both surfaces of the distance, metres, to the closest point with a like normal
    residual: float


def sample_surface(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], count: int = SAMPLES
) -> Surface:
    """Points at random over a surface, the same in every call."""
    across = face_vectors(vertices, faces)
    areas = np.linalg.norm(across, axis=1)
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), count, p=areas / areas.sum())
    shares = rng.dirichlet(np.ones(3), count)
    corners = faces[chosen]
    points = np.einsum("nc,nca->na", shares, vertices[corners])
    return Surface(points, across[chosen] / areas[chosen, None], corners, shares)


def search_tree(points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"]) -> cKDTree:
    """What `closest` searches."""
    return cKDTree(_features(points, normals))


def closest(
    tree: cKDTree, points: Float[np.ndarray, "N 3"], normals: Float[np.ndarray, "N 3"], count: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Distances (metres, unlike normals counting as distance) and indices of the closest points."""
    return tree.query(_features(points, normals), count)


def register(template: Template, surface: Surface) -> Registration:
    """Fit build and pose of the template to a person who stands upright, y up, in an A-pose or nearly
    so, and of about the size of an adult, for which the lengths above are meant.

    Which way the person looks is not known: `HEADINGS` starts around the vertical are fitted
    coarsely, and of those the best `FINALISTS` finely. Distances are weighted as by Geman and
    McClure with a scale that falls; build and pose are held by normal priors around the average
    build at rest.
    """
    search = search_tree(surface.points, surface.normals)
    starts = [_start(template, surface, 2 * np.pi * i / HEADINGS) for i in range(HEADINGS)]
    coarse = [_descend(template, surface, search, start, COARSE) for start in starts]
    coarse.sort(key=lambda found: found.residual)
    fine = [_descend(template, surface, search, found, FINE) for found in coarse[:FINALISTS]]
    return _descend(template, surface, search, min(fine, key=lambda found: found.residual), POLISH)


def _start(template: Template, surface: Surface, heading: float) -> Registration:
    """As tall as the surface, amid it, turned about the vertical."""
    low, high = surface.points.min(0), surface.points.max(0)
    rest = np.asarray(template.body.vertices)
    size = (high[1] - low[1]) / np.ptp(rest[:, 1])
    build = average_build(template)
    build = Build(jnp.asarray(np.log(size), build.size.dtype), build.builds, build.lengths, build.girths)
    pose = rest_pose(template.body.skeleton)
    turn = rotation.about_axis(jnp.array([0.0, 1.0, 0.0], rest.dtype), jnp.asarray(heading, rest.dtype))
    root = np.asarray(template.body.skeleton.centres[0])
    # the root lies amid the body, its height over the soles grows with the size
    place = np.median(surface.points, axis=0)
    place[1] = low[1] + size * (root[1] - rest[:, 1].min())
    shift = jnp.asarray(place - size * root, rest.dtype)
    pose = Pose(pose.translations.at[0].set(shift), pose.rotations.at[0].set(turn), pose.scale)
    return Registration(Person(build, pose), np.log(size), np.inf)


def _descend(
    template: Template,
    surface: Surface,
    search: cKDTree,
    start: Registration,
    scales: tuple[float, ...],
) -> Registration:
    """A step with new closest points for each of the scales."""
    areas = _vertex_areas(template)

    def remake(person: Person, scale: float) -> TemplateProblem:
        posed = pose_template(template, person)
        parts = *_attraction(posed, areas, surface, search, scale), start.size
        return TemplateProblem(
            template, posed.vertices, *(jnp.asarray(part, posed.vertices.dtype) for part in parts)
        )

    person = anneal(remake, start.person, LevenbergMarquardt(damping=DAMPING), scales)
    residual = _residual(pose_template(template, person), areas, surface, search)
    return Registration(person, start.size, residual)


def _attraction(
    posed: Posed, areas: np.ndarray, surface: Surface, search: cKDTree, scale: float
) -> tuple[Float[np.ndarray, "V 3 3"], Float[np.ndarray, "V 3"], float]:
    """The quadratic energy of every vertex about where it is, `d' A d - 2 b' d`, and what all are worth there: of its own
    closest point on the surface, and the points of the surface to which it is the closest vertex."""
    vertices, normals = np.asarray(posed.vertices, float), np.asarray(posed.normals, float)
    _, nearest = closest(search, vertices, normals)
    _, owner = closest(search_tree(vertices, normals), surface.points, surface.normals)
    source = np.concatenate([np.arange(len(vertices)), owner])
    target = np.concatenate([nearest, np.arange(len(surface.points))])
    share = np.concatenate([areas / areas.sum(), np.full(len(owner), 1 / len(owner))])
    gap = surface.points[target] - vertices[source]
    n = surface.normals[target]
    agreement = np.maximum(np.sum(n * normals[source], axis=1), 0.0)
    robust = (scale**2 / (scale**2 + np.sum(gap * gap, axis=1))) ** 2
    weight = 0.5 * EVIDENCE / (NOISE**2 + scale**2 / 4) * share * agreement * robust
    local = weight[:, None, None] * (n[:, :, None] * n[:, None, :] + SLIDE * np.eye(3))
    matrices, pulls = np.zeros((len(vertices), 3, 3)), np.zeros((len(vertices), 3))
    np.add.at(matrices, source, local)
    pulled = np.einsum("nab,nb->na", local, gap)
    np.add.at(pulls, source, pulled)
    return matrices, pulls, float(np.sum(gap * pulled))


def _residual(posed: Posed, areas: np.ndarray, surface: Surface, search: cKDTree) -> float:
    vertices, normals = np.asarray(posed.vertices, float), np.asarray(posed.normals, float)
    there, _ = closest(search, vertices, normals)
    back, _ = closest(search_tree(vertices, normals), surface.points, surface.normals)
    return float(0.5 * np.average(np.minimum(there, CUT), weights=areas) + 0.5 * np.minimum(back, CUT).mean())


def _vertex_areas(template: Template) -> Float[np.ndarray, "V"]:
    vertices, faces = np.asarray(template.body.vertices, float), np.asarray(template.body.faces)
    areas = np.zeros(len(vertices))
    np.add.at(areas, faces.ravel(), np.repeat(np.linalg.norm(face_vectors(vertices, faces), axis=1) / 6, 3))
    return areas


def _features(points: np.ndarray, normals: np.ndarray) -> Float[np.ndarray, "N 6"]:
    """Where points are close and their normals alike, these are close."""
    return np.concatenate([points, NORMAL_SCALE * normals], axis=1)
