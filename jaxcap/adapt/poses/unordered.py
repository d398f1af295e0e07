"""Find the poses of unordered scans, each from those of the most similar explained scans."""

import functools
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...body.body import Body, body_height
from ...body.decimate import reduce_body
from ...body.pose import Pose, concatenate_poses
from ...fit.correspondence.part_blocks import make_part_blocks
from ...geometry.attachment import attach_points, attached_positions
from ...observe import thin_cloud
from ...observe.clouds import Cloud
from ...tracking.compare_poses import track_from
from ...tracking.expectation_maximisation.pose_log_density import pose_log_density
from ...tracking.search.anneal import anneal_survivors
from ...tracking.search.initialise import COARSE_POINTS, COARSE_SIGMAS, COARSE_VERTICES, initialise
from ...tracking.search.starts import rotated_starts
from ...tracking.track_frame import Tracker
from ..task import AdaptTask, make_task_tracker
from .similarity import DIRECTIONS, DistanceField, distance_field, rotated_distances

#: number of similar scans that provide start poses, each in its best direction and the opposite one
NUM_SIMILAR = 2
#: the same number for a frame that stays worse than the others, each in four directions
NUM_SIMILAR_SEARCH = 6
#: a frame is worse than the others if its mean log-likelihood is by so many deviations, and this much, below
#: their median
MAX_DEVIATIONS, MIN_DEFICIT = 3.0, 0.3
UP = (0.0, 1.0, 0.0)


class FoundPoses(NamedTuple):
    """The poses of unordered scans so far."""

    #: the known poses by frame
    poses: dict[int, Pose]
    #: mean log-likelihood of each pose
    likelihoods: dict[int, float]

    @property
    def explained(self) -> list[int]:
        """The frames that are explained about as well as most."""
        frames = sorted(self.likelihoods)
        worse = worse_than_usual(np.array([self.likelihoods[frame] for frame in frames]))
        return [frame for frame, bad in zip(frames, worse, strict=True) if not bad]

    def keep_likelier(self, frame: int, pose: Pose, likelihood: float) -> "FoundPoses":
        """Replace the pose of a frame if the new one is likelier."""
        if likelihood <= self.likelihoods.get(frame, -np.inf):
            return self
        return FoundPoses(self.poses | {frame: pose}, self.likelihoods | {frame: likelihood})


def worse_than_usual(likelihoods: Float[np.ndarray, "F"]) -> Bool[np.ndarray, "F"]:
    """Find frames that are explained worse than is normal for all of them, by median and MAD."""
    likelihoods = np.where(np.isnan(likelihoods), -np.inf, likelihoods)
    middle = np.median(likelihoods)
    spread = 1.4826 * np.median(np.abs(likelihoods - middle))
    return ~(likelihoods >= middle - max(MAX_DEVIATIONS * spread, MIN_DEFICIT))


def visiting_order(shapes: Mapping[int, DistanceField]) -> list[int]:
    """Sort frames so that each is as similar as possible to one before it; the first one stays first."""
    frames = list(shapes)
    order, nearest = frames[:1], dict.fromkeys(frames[1:], np.inf)
    while nearest:
        for frame in nearest:
            distance = float(rotated_distances(shapes[order[-1]], shapes[frame]).min())
            nearest[frame] = min(nearest[frame], distance)
        order.append(min(nearest, key=lambda frame: nearest[frame]))
        del nearest[order[-1]]
    return order


def find_poses(
    task: AdaptTask, body: Body, poses: Mapping[int, Pose], *, is_known: bool, num_done: int = 0
) -> Iterator[tuple[FoundPoses, int]]:
    """Find the poses of unordered scans; yield them and the number of finished frames after every frame.

    A frame keeps the pose that explains it best among three kinds: its own in `poses`, the refined one, and
    those fitted from the poses of the most similar explained scans. Then frames that stay worse than the
    others are searched widely.

    **Arguments:** `is_known` is true if all of the `poses` belong to their frames, false if only that of the
    first frame does; `num_done` is the number of frames that an earlier run had finished.
    """
    search, found = _Search(task, body), FoundPoses({}, {})
    order = visiting_order(search.shapes)
    for frame in order if is_known else order[: max(num_done, 1)]:
        found = found.keep_likelier(frame, poses[frame], search.likelihood(frame, poses[frame]))
    for number, frame in enumerate(order[num_done:], num_done + 1):
        if frame in found.poses:
            found = found.keep_likelier(frame, *search.refine(frame, found.poses[frame]))
        found = found.keep_likelier(frame, *search.fit_from_similar(frame, found))
        yield found, number
    for frame in [frame for frame in order if frame not in found.explained]:
        found = found.keep_likelier(frame, *search.search_widely(frame, found))
    yield found, len(order)


class _Search:
    """The trackers, clouds and similarities of a search."""

    def __init__(self, task: AdaptTask, body: Body):
        height = float(body_height(body))
        self.tracker = make_task_tracker(task, body)
        self.coarse = coarse_template_tracker(task.template, self.tracker)
        # a frame is read several times in a row
        self.cloud = functools.lru_cache(2)(task.cloud)
        self.shapes = {frame: distance_field(self.cloud(frame), height) for frame in task.scanned}

    def likelihood(self, frame: int, pose: Pose) -> float:
        return float(pose_log_density(self.tracker, pose, self.cloud(frame)))

    def refine(self, frame: int, pose: Pose) -> tuple[Pose, float]:
        """Refine a nearby pose by the tracker."""
        state, _, likelihood = track_from(self.tracker, pose, self.cloud(frame))
        return state.estimate.pose, likelihood

    def fit_from_similar(self, frame: int, found: FoundPoses) -> tuple[Pose, float]:
        """Find the best pose from those of a few similar frames."""
        cloud = thin_cloud(self.cloud(frame), COARSE_POINTS)
        starts = self.start_poses(frame, found, cloud, NUM_SIMILAR, 2)
        sigmas = jnp.asarray(np.repeat(COARSE_SIGMAS, 2), starts.rotations.dtype)
        poses = anneal_survivors(self.coarse, cloud, starts, sigmas)
        return self.refine(frame, jax.tree.map(lambda leaf: leaf[0], poses))

    def search_widely(self, frame: int, found: FoundPoses) -> tuple[Pose, float]:
        """Search for a pose as in a first frame, from those of similar frames."""
        cloud = self.cloud(frame)
        starts = self.start_poses(frame, found, thin_cloud(cloud, COARSE_POINTS), NUM_SIMILAR_SEARCH, 4)
        pose, _ = initialise(self.tracker, cloud, coarse=self.coarse, starts=starts)
        return self.refine(frame, pose)

    def start_poses(self, frame: int, found: FoundPoses, cloud: Cloud, count: int, turns: int) -> Pose:
        """Stack start poses from the most similar explained frames, in `turns` directions each."""
        own = self.shapes[frame]
        distances = {n: rotated_distances(self.shapes[n], own) for n in found.explained if n != frame}
        near = sorted(distances, key=lambda n: float(distances[n].min()))[:count]
        # a single frame starts from its own pose
        near = near or [frame]
        picked = []
        for number in range(count):
            source = near[number % len(near)]
            best = int(np.argmin(distances[source])) if source in distances else 0
            rows = (best + np.arange(turns) * DIRECTIONS // turns) % DIRECTIONS
            turned = rotated_starts(self.coarse, cloud, found.poses[source], DIRECTIONS, jnp.asarray(UP))
            picked.append(jax.tree.map(lambda leaf, rows=rows: leaf[rows], turned))
        return concatenate_poses(picked)


def coarse_template_tracker(template: Body, tracker: Tracker) -> Tracker:
    """Make a tracker of fewer vertices for searches.

    Its triangles depend only on the template, so that another body does not compile again.
    """
    body, coarse = tracker.body, reduce_body(template, COARSE_VERTICES)
    if coarse is template:
        return tracker
    hold = attach_points(
        np.asarray(coarse.vertices, float), np.asarray(template.vertices, float), np.asarray(template.faces)
    )
    positions = jnp.asarray(attached_positions(hold, np.asarray(body.vertices, float)), body.vertices.dtype)
    coarse = Body(body.skeleton, coarse.skin, positions, coarse.faces)
    parts = make_part_blocks(coarse.skin.dominant_bones(), coarse.skeleton.num_joints, coarse.vertices)
    return eqx.tree_at(lambda t: (t.body, t.parts), tracker, (coarse, parts))
