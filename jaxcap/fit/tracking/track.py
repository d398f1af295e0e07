"""Tracking of whole sequences, as a stream or at once."""

import logging
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import numpy as np

from ...arguments import check_rate, checked
from ...body.body import Body
from ...body.pose import Motion, Pose, rest_pose, stack_poses
from ...energy.check_energies import UserTerms
from ...errors import InputError
from ...observe import Scan
from ...observe.clouds import Cloud, CloudFrames, as_cloud
from ...value_checks import check_direction
from ..judgement.baseline import initial_baseline
from ..judgement.region_samples import sample_regions
from .check_cloud import check_cloud
from .compare_poses import choose_likeliest, likelier_pose
from .follow import follow_frame
from .initialise import coarse_tracker, initialise
from .recover import (
    SearchHistory,
    TrackedFrame,
    choose_better,
    finish_frame,
    judge_frame,
    needs_search,
    search_frame,
    track_first_frame,
)
from .track_frame import Tracker, check_sigma, make_tracker

_LOG = logging.getLogger(__name__)
#: largest numbers of frames and reasons named in a sentence
MAX_NAMED_FRAMES, MAX_NAMED_REASONS = 20, 4
#: search for the pose of a first frame: if the start does not explain the cloud, always, never
FirstSearch = Literal["auto"] | bool


class Search(NamedTuple):
    """A search that is about to begin; the first one of a process compiles for a minute or more."""

    #: number of the frame
    frame: int
    #: the faults, as in `TrackedFrame.reasons`; empty for a requested search
    reasons: tuple[str, ...]
    #: number of earlier searches
    num_earlier: int


@checked
def track_frames(
    tracker: Tracker,
    clouds: Iterable[Cloud | Scan] | Cloud,
    start: Pose | TrackedFrame | None = None,
    *,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    first: int = 0,
    on_search: Callable[[Search], None] | None = None,
    candidates: Callable[[int], Sequence[Pose]] | None = None,
    margin: float = 0.0,
) -> Iterator[TrackedFrame]:
    """Track a stream of clouds; yield each frame as soon as it is done.

    **Arguments:** `start` is the pose to begin at, rest where not given, or the last `TrackedFrame` of an
    interrupted run; `search`: find the first pose by `initialise` if `start` does not explain the first cloud
    ("auto"), always (true) or never (false); `sigma` metres is the initial standard deviation of the first
    frame (Kineben's sigma0); `up` is the vertical of the scene; `first` is the number of the first cloud, so
    that a resumed run searches as an uninterrupted one; `on_search` is called before every search;
    `candidates(number)` gives other candidate poses of a frame: the frame keeps the likeliest, and leaves the
    tracked pose only for one with a mean log-likelihood better by more than `margin`.

    A frame is judged by the points that no part explains and by the surface without points in view of a
    sensor, compared with the baseline of the previous frames. A frame that is not good is searched for
    from many starts; after a search without success the next one waits, twice as long each time. A frame that
    nothing explains is `lost`, and tracking goes on.

    **Raises:** `InputError` for an invalid `sigma` or `up`, and, when its turn comes, for a cloud with fewer
    points than the pose has parameters, or in another unit.
    """
    check_sigma("track_frames", sigma)
    check_direction("track_frames", up=up)
    return _track_frames(tracker, clouds, start, search, sigma, up, first, on_search, candidates, margin)


def _track_frames(
    tracker: Tracker,
    clouds: Iterable[Cloud | Scan] | Cloud,
    start: Pose | TrackedFrame | None,
    search: FirstSearch,
    sigma: float,
    up: tuple[float, float, float],
    first: int,
    on_search: Callable[[Search], None] | None,
    candidates: Callable[[int], Sequence[Pose]] | None,
    margin: float,
) -> Iterator[TrackedFrame]:
    """Track as `track_frames` does, after its checks."""
    coarse, surface = None, sample_regions(tracker.body)
    frame, pose = (start, None) if isinstance(start, TrackedFrame) else (None, start)

    def begin_search(number: int, reasons: tuple[str, ...], before: float) -> Tracker:
        _LOG.info("searching for a better pose of frame %d", number)
        if on_search is not None:
            on_search(Search(number, reasons, int(before)))
        return coarse_tracker(tracker) if coarse is None else coarse

    for number, cloud in enumerate(_iterate_clouds(clouds), first):
        check_cloud(tracker.body, cloud, f"cloud {number}")
        if frame is None:
            pose = rest_pose(tracker.body.skeleton) if pose is None else pose
            if search is not True:
                frame = track_first_frame(tracker, surface, cloud, pose, sigma)
            if frame is None or (search == "auto" and frame.verdict != "good"):
                coarse = begin_search(number, () if frame is None else frame.reasons, 0.0)
                pose, _ = initialise(tracker, cloud, up=up, coarse=coarse)
                found = track_first_frame(tracker, surface, cloud, pose, 0.03)
                frame = found if frame is None else choose_better(tracker, cloud, found, frame)
                frame = eqx.tree_at(lambda f: f.searches.count, frame, 1.0)
            if candidates is not None:
                reached = frame.state, frame.statistics
                state, statistics = choose_likeliest(
                    tracker, *reached, candidates(number), pose, cloud, margin
                )
                if state is not frame.state:
                    baseline = initial_baseline(surface, len(cloud.views))
                    searches = SearchHistory(count=frame.searches.count)
                    frame = judge_frame(surface, cloud, state, statistics, baseline, searches)
                    frame = finish_frame(tracker, frame, pose)
        else:
            trusted, baseline = frame.trusted, frame.baseline
            others = () if candidates is None else candidates(number)
            frame = follow_frame(tracker, surface, frame, cloud, others, margin)
            if needs_search(frame):
                coarse = begin_search(number, frame.reasons, frame.searches.count)
                key = jax.random.key(number)
                found = search_frame(tracker, surface, coarse, frame, baseline, trusted, cloud, key, up)
                if candidates is not None and found.pose is not frame.pose:
                    # the end of a search may be worse than its start
                    likelier = likelier_pose(tracker, found.pose, frame.pose, cloud)
                    found = found if likelier is found.pose else frame
                frame = found
            frame = finish_frame(tracker, frame, trusted)
        yield frame


@checked
def track(
    body: Body,
    clouds: Iterable[Cloud | Scan] | Cloud,
    start: Pose | None = None,
    *,
    rate: float = 30.0,
    tracker: Tracker | None = None,
    search: FirstSearch = "auto",
    sigma: float = 0.1,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    terms: UserTerms = (),
) -> Motion:
    """Track a body through a sequence of clouds and return its motion (Kineben, section 3.3).

    **Arguments:** `clouds` from `make_cloud`, one per frame, or stacked over frames; `start` a pose near that
    of the first frame; `rate` frames per second; `tracker` for other settings than the default, made of the
    same body; `search`, `sigma` and `up` as in `track_frames`; `terms`, further energies in units of a
    log-likelihood, such as `make_floor(body)`, where no tracker is given. A warning names lost or doubtful
    frames, with their faults, and parts of the body without points; `track_frames` gives the verdict on each
    frame.

    **Raises:** `InputError` for a cloud with fewer points than the pose has parameters, or in another unit.
    """
    if tracker is not None and terms != ():
        raise InputError(
            "track: `terms` and `tracker` were both given; give the terms to make_tracker(body, terms=...)."
        )
    check_rate("track", rate)
    tracker = make_tracker(body, terms=terms) if tracker is None else tracker
    poses, verdicts, unseen = [], [], []
    for frame in track_frames(tracker, clouds, start, search=search, sigma=sigma, up=up):
        # copies in NumPy: a JAX array has an overhead of a kilobyte
        poses.append(jax.tree.map(np.array, frame.pose))
        verdicts.append((frame.verdict, frame.reasons))
        unseen.append(frame.unseen)
    for sentence in (*verdict_sentences(verdicts), *unseen_sentences(unseen)):
        warnings.warn(f"{sentence}.", stacklevel=3)
    return stack_poses(poses, rate)


def verdict_sentences(verdicts: Sequence[tuple[str, Sequence[str]]]) -> list[str]:
    """Describe the lost and the doubtful frames, with reasons; without full stops.

    **Arguments:** `verdict` and `reasons` of every `TrackedFrame`.
    """
    sentences = []
    for verdict in ("lost", "doubtful"):
        numbers = [number for number, (found, _) in enumerate(verdicts) if found == verdict]
        if not numbers:
            continue
        named = ", ".join(map(str, numbers[:MAX_NAMED_FRAMES])) + (
            " and more" if len(numbers) > MAX_NAMED_FRAMES else ""
        )
        counts = Counter(reason for number in numbers for reason in verdicts[number][1])
        reasons = "; ".join(
            f"{reason} (in {count})" for reason, count in counts.most_common(MAX_NAMED_REASONS)
        )
        sentences.append(
            f"{len(numbers)} of {len(verdicts)} frames are {verdict}: {named}, counted from 0; {reasons}"
        )
    if len(verdicts) > 1 and verdicts[0][0] == "doubtful":
        sentences.append(
            "the first frame is doubtful, and later frames are compared with it: faults that they share "
            "with it are not reported; check that frame, or give a better first pose"
        )
    return sentences


def unseen_sentences(unseen: Sequence[Sequence[str]]) -> list[str]:
    """Describe the parts of the body without points, with numbers of frames; without a full stop.

    **Arguments:** `unseen` of every `TrackedFrame`.
    """
    counts = Counter(part for parts in unseen for part in parts)
    if not counts:
        return []
    named = ", ".join(f"{part} (in {count})" for part, count in counts.most_common(MAX_NAMED_REASONS))
    more = f" and {len(counts) - MAX_NAMED_REASONS} other parts" if len(counts) > MAX_NAMED_REASONS else ""
    return [
        f"{sum(map(bool, unseen))} of {len(unseen)} frames do not show the whole body: no points belong to "
        f"{named}{more}, and their poses in these frames are guesses"
    ]


def _iterate_clouds(clouds: Iterable[Cloud | Scan] | Cloud) -> Iterator[Cloud]:
    """Iterate over frames, also of scans as read from files, and of one cloud stacked over frames."""
    if isinstance(clouds, (Cloud, Scan)):
        return iter(CloudFrames(clouds))  # pyright: ignore[reportArgumentType] - a scan is refused there
    return (as_cloud(cloud, number) for number, cloud in enumerate(clouds))
