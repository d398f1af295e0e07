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
from ...body.decimate import attach, follow, reduce_body
from ...body.pose import Pose
from ...fit.correspondence.part_blocks import make_parts
from ...fit.tracking.initialise import (
    COARSE,
    COARSE_POINTS,
    COARSE_VERTICES,
    anneal_all,
    initialise,
    turned_starts,
)
from ...fit.tracking.likeliest import improve, log_likelihood
from ...fit.tracking.track_frame import Tracker
from ...observe import Cloud, thin_cloud
from ..task import AdaptTask, tracker_of
from .similarity import DIRECTIONS, Shape, shape_of, turned_distances

#: number of similar scans that provide start poses, each in its best direction and the opposite one
NEAR = 2
#: the same number for a frame that stays worse than the others, each in four directions
SEARCHED = 6
#: a frame is worse than the others if its mean log-likelihood is by so many deviations, and this much, below
#: their median
DEVIATIONS, BELOW_MEDIAN = 3.0, 0.3
UP = (0.0, 1.0, 0.0)


class Found(NamedTuple):
    """The poses of unordered scans so far."""

    #: the known poses by frame
    poses: dict[int, Pose]
    #: mean log-likelihood of each pose
    likelihoods: dict[int, float]

    @property
    def explained(self) -> list[int]:
        """The frames that are explained about as well as most."""
        frames = sorted(self.likelihoods)
        worse = are_worse(np.array([self.likelihoods[frame] for frame in frames]))
        return [frame for frame, bad in zip(frames, worse, strict=True) if not bad]

    def better(self, frame: int, pose: Pose, likelihood: float) -> "Found":
        """Replace the pose of a frame if the new one is likelier."""
        if likelihood <= self.likelihoods.get(frame, -np.inf):
            return self
        return Found(self.poses | {frame: pose}, self.likelihoods | {frame: likelihood})


def are_worse(likelihoods: Float[np.ndarray, "F"]) -> Bool[np.ndarray, "F"]:
    """Find frames that are explained worse than is normal for all of them, by median and MAD."""
    likelihoods = np.where(np.isnan(likelihoods), -np.inf, likelihoods)
    middle = np.median(likelihoods)
    spread = 1.4826 * np.median(np.abs(likelihoods - middle))
    return ~(likelihoods >= middle - max(DEVIATIONS * spread, BELOW_MEDIAN))


def visiting_order(shapes: Mapping[int, Shape]) -> list[int]:
    """Sort frames so that each is as similar as possible to one before it; the first one stays first."""
    frames = list(shapes)
    order, nearest = frames[:1], dict.fromkeys(frames[1:], np.inf)
    while nearest:
        for frame in nearest:
            apart = float(turned_distances(shapes[order[-1]], shapes[frame]).min())
            nearest[frame] = min(nearest[frame], apart)
        order.append(min(nearest, key=lambda frame: nearest[frame]))
        del nearest[order[-1]]
    return order


def find_poses(
    task: AdaptTask, body: Body, poses: Mapping[int, Pose], *, known: bool, done: int = 0
) -> Iterator[tuple[Found, int]]:
    """Find the poses of unordered scans; yield them and the number of finished frames after every frame.

    A frame keeps the pose that explains it best among three kinds: its own in `poses`, the refined one, and
    those fitted from the poses of the most similar explained scans. Then frames that stay worse than the
    others are searched widely.

    **Arguments:** `known` is true if all of the `poses` belong to their frames, false if only that of the
    first frame does; `done` is the number of frames that an earlier run had finished.
    """
    search, found = _Search(task, body), Found({}, {})
    order = visiting_order(search.shapes)
    for frame in order if known else order[: max(done, 1)]:
        found = found.better(frame, poses[frame], search.likelihood(frame, poses[frame]))
    for number, frame in enumerate(order[done:], done + 1):
        if frame in found.poses:
            found = found.better(frame, *search.improved(frame, found.poses[frame]))
        found = found.better(frame, *search.near(frame, found))
        yield found, number
    for frame in [frame for frame in order if frame not in found.explained]:
        found = found.better(frame, *search.widely(frame, found))
    yield found, len(order)


class _Search:
    """The trackers, clouds and similarities of a search."""

    def __init__(self, task: AdaptTask, body: Body):
        height = float(body_height(body))
        self.tracker = tracker_of(task, body)
        self.coarse = coarse_like(task.template, self.tracker)
        # a frame is read several times in a row
        self.cloud = functools.lru_cache(2)(task.cloud)
        self.shapes = {frame: shape_of(self.cloud(frame), height) for frame in task.scanned}

    def likelihood(self, frame: int, pose: Pose) -> float:
        return float(log_likelihood(self.tracker, pose, self.cloud(frame)))

    def improved(self, frame: int, pose: Pose) -> tuple[Pose, float]:
        """Refine a nearby pose by the tracker."""
        state, _, likelihood = improve(self.tracker, pose, self.cloud(frame))
        return state.estimate.pose, likelihood

    def near(self, frame: int, found: Found) -> tuple[Pose, float]:
        """Find the best pose from those of a few similar frames."""
        cloud = thin_cloud(self.cloud(frame), COARSE_POINTS)
        starts = self.starts(frame, found, cloud, NEAR, 2)
        sigmas = jnp.asarray(np.repeat(COARSE, 2), starts.rotations.dtype)
        poses, _ = anneal_all(self.coarse, cloud, starts, sigmas)
        return self.improved(frame, jax.tree.map(lambda leaf: leaf[0], poses))

    def widely(self, frame: int, found: Found) -> tuple[Pose, float]:
        """Search for a pose as in a first frame, from those of similar frames."""
        cloud = self.cloud(frame)
        starts = self.starts(frame, found, thin_cloud(cloud, COARSE_POINTS), SEARCHED, 4)
        pose, _ = initialise(self.tracker, cloud, coarse=self.coarse, starts=starts)
        return self.improved(frame, pose)

    def starts(self, frame: int, found: Found, cloud: Cloud, count: int, turns: int) -> Pose:
        """Stack start poses from the most similar explained frames, in `turns` directions each."""
        own = self.shapes[frame]
        apart = {n: turned_distances(self.shapes[n], own) for n in found.explained if n != frame}
        near = sorted(apart, key=lambda n: float(apart[n].min()))[:count]
        # a single frame starts from its own pose
        near = near or [frame]
        picked = []
        for number in range(count):
            source = near[number % len(near)]
            best = int(np.argmin(apart[source])) if source in apart else 0
            rows = (best + np.arange(turns) * DIRECTIONS // turns) % DIRECTIONS
            turned = turned_starts(self.coarse, cloud, found.poses[source], DIRECTIONS, jnp.asarray(UP))
            picked.append(jax.tree.map(lambda leaf, rows=rows: leaf[rows], turned))
        return jax.tree.map(lambda *leaves: jnp.concatenate(leaves), *picked)


def coarse_like(template: Body, tracker: Tracker) -> Tracker:
    """Make a tracker of fewer vertices for searches.

    Its triangles depend only on the template, so that another body does not compile again.
    """
    body, coarse = tracker.body, reduce_body(template, COARSE_VERTICES)
    if coarse is template:
        return tracker
    hold = attach(
        np.asarray(coarse.vertices, float), np.asarray(template.vertices, float), np.asarray(template.faces)
    )
    places = jnp.asarray(follow(hold, np.asarray(body.vertices, float)), body.vertices.dtype)
    coarse = Body(body.skeleton, coarse.skin, places, coarse.faces)
    parts = make_parts(coarse.skin.parts(), coarse.skeleton.num_joints, coarse.vertices)
    return eqx.tree_at(lambda t: (t.body, t.parts), tracker, (coarse, parts))
