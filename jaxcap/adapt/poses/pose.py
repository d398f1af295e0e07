"""The pose of one frame: pairs, a damped step, and again (Adaptation, 4.1.4)."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.limits.rotation_vector_boxes import PoseBoxes
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...energy.data.pairs import Pairs
from ...energy.energy import AbstractEnergy
from ...fit.alternate import alternate
from ...fit.correspondence.correspond import Matching, Scan, as_scan, find_pairs
from ...fit.correspondence.visibility import visible_vertices
from ...fit.problem import PoseProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.camera import Camera
from ...observe import Cloud
from ...observe import Scan as FileScan
from ..problems import mean_square, pose_problem

#: lengths of a step that are tried: further than it says, as nearest neighbours hold a surface back, and shorter
LENGTHS = (1.5, 1.0, 0.5, 0.25, 0.1)
#: steps that may raise Q before the best pose is returned to, and the share of Q that one has to better it by
UPHILL, ENOUGH = 2, 1e-3
#: rows and columns of the buffers that tell what cameras see: as rays do of 98 % of vertices and more
PIXELS = 256


class PoseFit(NamedTuple):
    """A pose and how well it meets its scan."""

    pose: Pose
    #: mean weighed squared distance of a pair, metres squared
    data: float
    #: the last pairs
    pairs: Pairs


@checked
def fit_pose(
    body: Body,
    scan: Scan | Cloud | FileScan,
    start: Pose,
    prior: AbstractEnergy,
    matching: Matching = Matching(),
    *,
    weight: float = 1e-6,
    steps: int = 10,
    damping: float = 1e-3,
    cameras: Sequence[Camera] = (),
    boxes: PoseBoxes | None = None,
    terms: AbstractEnergy | None = None,
) -> PoseFit:
    """The pose of a frame from one near it: Q_data + weight Q_prior, with Q_data the mean over pairs.

    Each step finds pairs anew and is one of Levenberg-Marquardt for these, at the best of some lengths (Adaptation, 4.1.4). `damping`
    is that of the first step, as a share of each curvature. New pairs may raise Q; some such steps are gone on from, and the best pose is kept.

    The `scan` may be a cloud, or as `read_clouds` gives it, of which `make_scan` is made here. `boxes` are hard. What the start has beyond them is brought back first. `cameras` as in `pairs_of`. `terms` are further
    energies in units of a log-likelihood.
    """
    scan = as_scan(scan)
    start = start if boxes is None else brought_in(boxes, body.skeleton, start)

    def remake(pose: Pose) -> PoseProblem:
        return pose_problem(body, pairs_of(body, pose, scan, matching, cameras), prior, weight, boxes, terms)

    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=damping, relative=True, lengths=LENGTHS)
    found = alternate(remake, start, solver, rounds=steps, enough=ENOUGH, uphill=UPHILL)
    pairs = found.problem.energy.terms[0].energy.pairs
    return PoseFit(found.y, mean_square(body, found.y, pairs), pairs)


def pairs_of(
    body: Body,
    pose: Pose,
    scan: Scan,
    matching: Matching,
    cameras: Sequence[Camera] = (),
) -> Pairs:
    """The pairs of a posed body with a scan. Vertices that none of the `cameras` sees are in no pair (4.1.2, visibility
    constraint); no cameras say nothing."""
    posed, normals = _surface(body, pose)
    visible = np.asarray(visible_vertices(cameras, posed, body.faces, pixels=PIXELS)) if cameras else None
    faces = np.asarray(body.faces)
    return find_pairs(np.asarray(posed, float), np.asarray(normals, float), faces, scan, matching, visible)


@eqx.filter_jit
def _surface(body: Body, pose: Pose):
    posed = pose_body(body, pose)
    return posed.vertices, posed.normals


@eqx.filter_jit
def brought_in(boxes: PoseBoxes, skeleton: Skeleton, pose: Pose) -> Pose:
    """The pose with every number that is beyond its box at the end of it."""
    return boxes.nearest(skeleton, pose)


def same_pose(a: Pose, b: Pose) -> bool:
    """Tell whether two poses are the same to the last bit."""
    return all(np.array_equal(x, y) for x, y in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True))
