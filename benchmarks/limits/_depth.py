"""Fit poses to real frames of a depth camera, each of the upper body of a person."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

import jaxcap as jc
from benchmarks.report import progress
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.energy import Sum, terms_of
from jaxcap.fit.strict_priorities import priority_step
from jaxcap.geometry.normals import estimate_normals
from jaxcap.limits.abstract_limits import allowed
from jaxcap.limits.implicit_surface import SurfaceLimits
from jaxcap.tracking.expectation_maximisation.em_step import (
    Estimate,
    box_volume,
    data_energy,
    e_step,
    uniform_priors,
)

#: pixels, of 640 x 480
FOCAL, CENTRE = 525.0, (320.0, 240.0)
#: what lies further behind the median than this is another person, metres
MAX_DEPTH_BEHIND = 0.3
#: pieces of the person have at least this share of the pixels of the largest
MIN_PIECE_SHARE = 0.01
#: points of a frame that are fitted
POINTS = 4000
#: weight of limits in the search; how often points are assigned anew afterwards, with limits first
LIMIT_WEIGHT, ROUNDS = 1000.0, 10
#: deviation of the points from the surface in these, metres
SIGMA = 0.015
#: the pelvis is known to stand upright and turned to the camera to about so many radians: of the front
#: of a trunk a search would else make a body that leans back, or its back
PELVIS_DEVIATION = 0.05
LEGS = ("LHipJoint", "RHipJoint")


class DepthFit(NamedTuple):
    """A frame and its fitted pose."""

    cloud: jc.Cloud
    pose: jc.Pose
    #: as the search left it, with limits as one energy among others
    initial_pose: jc.Pose
    #: of every joint with limits, at both
    valid: Bool[np.ndarray, "J"]
    initial_valid: Bool[np.ndarray, "J"]
    #: median distance of points from the surface's vertices, millimetres
    distance_mm: float


def depth_frames(shared: Path) -> Int[np.ndarray, "F 480 640"]:
    """Load depth images, millimetres; zero is no measurement."""
    with np.load(shared / "data" / "depth" / "skeltrack_depth12_mm.npz") as file:
        return file["depth_mm"]


def depth_cloud(image: Int[np.ndarray, "480 640"], count: int = POINTS) -> jc.Cloud:
    """Compute the points of the foremost person, y up and z towards the camera, which is the origin."""
    depth = image / 1000.0
    near = (image > 0) & (depth < np.median(depth[image > 0]) + MAX_DEPTH_BEHIND)
    pieces = np.zeros(image.shape, int)
    ndimage.label(near, output=pieces)
    sizes = np.bincount(pieces.reshape(-1))
    sizes[0] = 0
    rows, columns = np.nonzero((sizes > MIN_PIECE_SHARE * sizes.max())[pieces])
    z = depth[rows, columns]
    points = np.stack([(columns - CENTRE[0]) * z / FOCAL, (CENTRE[1] - rows) * z / FOCAL, -z], 1)
    chosen = np.random.default_rng(0).choice(len(points), min(count, len(points)), replace=False)
    points = points[chosen]
    normals = estimate_normals(points)
    # all that is seen faces the camera
    normals = np.where(np.sum(normals * points, 1, keepdims=True) > 0, -normals, normals)
    return jc.make_cloud(points, normals)


def upper_body(body: jc.Body) -> jc.Body:
    """Remove the surface of the legs, which no frame shows, and fix their joints at rest."""
    skeleton = body.skeleton
    legs = np.any([skeleton.descendants[skeleton.index(name)] for name in LEGS], axis=0)
    kept = ~legs[np.asarray(body.skin.dominant_bones())]
    faces = np.asarray(body.faces)
    faces = (np.cumsum(kept) - 1)[faces[kept[faces].all(1)]]
    kinds = tuple("fixed" if leg else kind for kind, leg in zip(skeleton.kinds, legs, strict=True))
    assert isinstance(body.skin, jc.LinearSkin)
    some = np.flatnonzero(kept)
    skin = jc.LinearSkin(body.skin.weights[some])
    return jc.Body(dataclasses.replace(skeleton, kinds=kinds), skin, body.vertices[some], jnp.asarray(faces))


def pelvis_prior(skeleton: jc.Skeleton) -> jc.energy.PosePrior:
    """Make a prior of the root's rotation alone."""
    layout = dof_layout(skeleton)
    translates = np.zeros(skeleton.num_dofs + 1, bool)
    translates[np.asarray(layout.translations).reshape(-1)] = True
    turns = (np.asarray(layout.joints) == 0) & ~translates[:-1]
    deviations = jnp.where(turns, PELVIS_DEVIATION, jnp.inf).astype(skeleton.centres.dtype)
    return jc.energy.PosePrior(jc.rest_pose(skeleton), deviations)


def fit_frames(images: np.ndarray, limits: SurfaceLimits) -> list[DepthFit]:
    """Fit each frame by itself.

    A search has limits among its energies. From the nearest valid pose, a fit then gives limits strict priority.
    A last projection removes rounding errors at the bounds.
    """
    body = upper_body(jc.human(resolution="low", joints="tracking"))
    tracker = jc.make_tracker(
        body, terms=(LIMIT_WEIGHT * jc.JointLimits(limits), pelvis_prior(body.skeleton))
    )
    found = []
    for number, image in enumerate(images):
        cloud = depth_cloud(image)
        searched, _ = jc.initialise(tracker, cloud, turns=1)
        pose = _fit_with_priority(tracker, limits, cloud, searched)
        valid, searched_valid = (np.asarray(_allowed(limits, body.skeleton, p)) for p in (pose, searched))
        distance = 1000 * float(_distance(body, cloud, pose))
        found.append(DepthFit(cloud, pose, searched, valid, searched_valid, distance))
        wrong = [n for n, good in zip(body.skeleton.names, searched_valid, strict=True) if not good]
        progress(
            f"depth frame {number}: {'valid' if valid.all() else 'NOT VALID'}, points {distance:.1f} mm from "
            f"vertices; beyond limits after the search: {', '.join(wrong) or 'none'}"
        )
    return found


@eqx.filter_jit
def _fit_with_priority(
    tracker: jc.fit.Tracker, limits: SurfaceLimits, cloud: jc.Cloud, start: jc.Pose
) -> jc.Pose:
    body, volume = tracker.body, box_volume(cloud)
    others = jc.RestPrior(tracker.rest_deviations), pelvis_prior(body.skeleton)
    sigma = jnp.asarray(SIGMA, start.rotations.dtype)

    def again(_, pose):
        estimate = Estimate(pose, sigma, uniform_priors(tracker.parts, sigma.dtype))
        posed, likely = e_step(body, tracker.parts, tracker.mixture, cloud, volume, estimate)
        data = data_energy(likely, posed, cloud, sigma, tracker.mixture.tangential_weight)
        return priority_step((jc.JointLimits(limits), Sum((*terms_of(data), *others))), body, pose)

    pose = limits.project(body.skeleton, start)
    return limits.project(body.skeleton, jax.lax.fori_loop(0, ROUNDS, again, pose))


@eqx.filter_jit
def _distance(body: jc.Body, cloud: jc.Cloud, pose: jc.Pose) -> Float[Array, ""]:
    vertices = jc.pose_body(body, pose).vertices
    nearest = jax.lax.map(
        lambda point: jnp.min(jnp.sum((vertices - point) ** 2, -1)), cloud.points, batch_size=64
    )
    return jnp.nanmedian(jnp.where(cloud.weights > 0, jnp.sqrt(nearest), jnp.nan))


_allowed = eqx.filter_jit(allowed)
