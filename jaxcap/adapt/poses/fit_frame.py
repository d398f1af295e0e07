"""The pose of one frame: pairs and damped steps in alternation (Adaptation, 4.1.4)."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np

from ...arguments import checked
from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...energy.data.pairs import PointPairs
from ...fit.alternate import alternate
from ...fit.correspondence.find_pairs import Matching, find_pairs
from ...fit.correspondence.nearest_assignment import IndexedScan, as_scan
from ...fit.pose_problem import PoseProblem
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.camera import Camera
from ...limits.rotation_vector_boxes import PoseBoxes
from ...observe import Scan
from ...observe.clouds import Cloud
from ...observe.visibility import visible_vertices
from ...parallel import parallel_map
from ..objective import PoseTerms, mean_squared_distance, pose_problem
from ..task import AdaptState, AdaptTask

#: tried factors of a step's length: also above one, as nearest neighbours slow a surface down
STEP_FACTORS = (1.5, 1.0, 0.5, 0.25, 0.1)
#: number of steps that may raise Q before the search ends, and relative decrease of Q that counts as progress
MAX_UPHILL_STEPS, MIN_RELATIVE_DECREASE = 2, 1e-3
#: rows and columns of the depth buffers for visibility, which agrees with ray casting for at least 98 % of
#: vertices
DEPTH_BUFFER_SIZE = 256


class PoseFit(NamedTuple):
    """A pose and its fit to a scan."""

    pose: Pose
    #: mean weighted squared distance of a pair, metres squared
    data: float
    #: the last pairs
    pairs: PointPairs


@checked
def fit_pose(
    body: Body,
    scan: IndexedScan | Cloud | Scan,
    start: Pose,
    terms: PoseTerms,
    matching: Matching = Matching(),
    *,
    steps: int = 10,
    damping: float = 1e-3,
    cameras: Sequence[Camera] = (),
) -> PoseFit:
    """Fit a body's pose to a scan from an initial pose: minimise `Q_data + weight Q_pose` and the user's terms.

    `Q_data` is the mean over pairs. Each iteration finds new pairs and takes a Levenberg-Marquardt step at
    the best of some lengths (Adaptation, 4.1.4). New pairs may raise Q: some such steps are accepted, and the
    best pose is returned.

    **Arguments:** `scan` may be a cloud, or an element of the result of `read_clouds`; `start` is the initial
    pose, which is clamped to the limits of `terms` first; `damping` is that of the first step, as a share of
    each curvature; `cameras` as in `pairs_of`.
    """
    scan = as_scan(scan)
    start = start if terms.boxes is None else clamp_pose(terms.boxes, body.skeleton, start)

    def remake(pose: Pose) -> PoseProblem:
        return pose_problem(body, pairs_of(body, pose, scan, matching, cameras), terms)

    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=damping, relative=True, lengths=STEP_FACTORS)
    found = alternate(
        remake, start, solver, rounds=steps, min_gain=MIN_RELATIVE_DECREASE, patience=MAX_UPHILL_STEPS
    )
    pairs = found.problem.energy.terms[0].energy.pairs
    return PoseFit(found.y, mean_squared_distance(body, found.y, pairs), pairs)


def fit_task_poses(
    task: AdaptTask, state: AdaptState, scans: Iterable[IndexedScan], starts: Iterable[Pose], *, steps: int
) -> Iterator[PoseFit]:
    """Fit the poses of a state's body to several scans of a task, each from its own start, on all cores."""
    terms, matching = task.pose_terms(state.pose_weight), task.settings.matching

    def fit(item: tuple[IndexedScan, Pose]) -> PoseFit:
        return fit_pose(state.body, *item, terms, matching, steps=steps, cameras=task.cameras)

    return parallel_map(fit, zip(scans, starts, strict=True))


def pairs_of(
    body: Body,
    pose: Pose,
    scan: IndexedScan,
    matching: Matching,
    cameras: Sequence[Camera] = (),
) -> PointPairs:
    """Find the pairs of a posed body with a scan.

    Vertices that none of the `cameras` sees are in no pair (4.1.2, visibility constraint). Without cameras,
    visibility is not tested.
    """
    posed, normals = _surface(body, pose)
    visible = (
        np.asarray(visible_vertices(cameras, posed, body.faces, pixels=DEPTH_BUFFER_SIZE))
        if cameras
        else None
    )
    faces = np.asarray(body.faces)
    return find_pairs(np.asarray(posed, float), np.asarray(normals, float), faces, scan, matching, visible)


@eqx.filter_jit
def _surface(body: Body, pose: Pose):
    posed = pose_body(body, pose)
    return posed.vertices, posed.normals


@eqx.filter_jit
def clamp_pose(boxes: PoseBoxes, skeleton: Skeleton, pose: Pose) -> Pose:
    """Clamp a pose to the limits of its joint rotations."""
    return boxes.project(skeleton, pose)
