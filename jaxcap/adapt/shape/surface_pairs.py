"""Points of several frames at their nearest points in the triangles of the posed body."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...energy.data.pairs import PairDistances, PointPairs, stack_pairs
from ...fit.correspondence.find_pairs import Matching, find_pairs
from ...fit.correspondence.nearest_assignment import IndexedScan, NearestOnSurface, make_scan
from ...observe.clouds import Cloud
from ...tracking.track_frame import Tracker

#: points farther from the surface are in no pair, as a multiple of their standard deviation in the frame, and metres
MAX_DEVIATIONS, MIN_REACH, FIRST_REACH = 4.0, 0.006, 0.05
#: least standard deviation of the points of a frame, metres
MIN_SIGMA = 5e-4
#: weight of squared distances along the surface: a point slides in its tangent plane to the place that shape and pose require
TANGENTIAL_WEIGHT = 0.001
#: of a normal distribution, standard deviation over median distance
_OF_MEDIAN = 1.4826


def normal_angle(tracker: Tracker) -> float:
    """Return the largest angle between the normals of a pair of a tracker, degrees."""
    return float(np.degrees(np.arccos(np.clip(float(tracker.mixture.normal_threshold), -1.0, 1.0))))


def index_clouds(clouds: Sequence[Cloud]) -> list[tuple[IndexedScan, Float[np.ndarray, "N"]]]:
    """Make the search trees of clouds, each with the weights of its points."""
    every = (np.asarray(cloud.weights, float) for cloud in clouds)
    return [(make_scan(cloud), weights[weights > 0]) for cloud, weights in zip(clouds, every, strict=True)]


def pair_frames(
    body: Body,
    poses: Pose,
    scans: Sequence[tuple[IndexedScan, Float[np.ndarray, "N"]]],
    sigmas: Float[Array, "F"] | None,
    max_normal_angle: float,
) -> tuple[PairDistances, Float[Array, "F"]]:
    """Pair the points of each frame with the surface, weighted by their standard deviation.

    **Arguments:** `scans` of `index_clouds`; `sigmas` of the frames before, metres, None for a first time; `max_normal_angle` of a pair,
    degrees.

    **Returns:** the distances, stacked over the frames, and the standard deviation of each frame across the surface, metres.
    """
    vertices, normals = (np.asarray(each, float) for each in _posed(body, poses))
    faces, pairs, found = np.asarray(body.faces), [], []
    for k, (scan, weights) in enumerate(scans):
        reach = FIRST_REACH if sigmas is None else max(MAX_DEVIATIONS * float(sigmas[k]), MIN_REACH)
        matching = Matching(
            max_normal_angle=max_normal_angle,
            max_distance=reach,
            from_body=False,
            uniform=False,
            charbonnier=reach,
            tangential_weight=TANGENTIAL_WEIGHT,
            assignment=NearestOnSurface(),
        )
        own = find_pairs(vertices[k], normals[k], faces, scan, matching)
        sigma = _sigma(own, vertices[k])
        masses = np.zeros(len(own.weights))
        masses[: len(weights)] = weights / sigma**2
        pairs.append(
            eqx.tree_at(lambda p: p.weights, own, own.weights * jnp.asarray(masses, own.weights.dtype))
        )
        found.append(sigma)
    dtype = poses.rotations.dtype
    stacked = jax.tree.map(lambda x: x.astype(dtype) if eqx.is_inexact_array(x) else x, stack_pairs(pairs))
    return PairDistances(stacked), jnp.asarray(found, dtype)


def _sigma(pairs: PointPairs, vertices: Float[np.ndarray, "V 3"]) -> float:
    """Estimate the standard deviation of the points of a frame across the surface from their median distance."""
    kept = np.asarray(pairs.weights) > 0
    if not kept.any():
        return FIRST_REACH
    corners, shares = np.asarray(pairs.vertices)[kept], np.asarray(pairs.barycentric)[kept]
    gaps = np.einsum("ck,cka->ca", shares, vertices[corners]) - np.asarray(pairs.points)[kept]
    across = np.abs(np.sum(gaps * np.asarray(pairs.normals)[kept], 1))
    return max(_OF_MEDIAN * float(np.median(across)), MIN_SIGMA)


@eqx.filter_jit
def _posed(body: Body, poses: Pose):
    def one(pose: Pose):
        posed = pose_body(body, pose)
        return posed.vertices, posed.normals

    return jax.lax.map(one, poses)
