"""Tracking of whole sequences, as a stream or at once."""

import dataclasses
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

import jax
import numpy as np

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose, rest_pose, stack_poses
from ..compiled import forget_many_compiled
from ..energy.check_energies import UserTerms, check_finite_residuals
from ..energy.energy import Sum
from ..errors import InputError
from ..observe import Scan
from ..observe.clouds import Cloud, CloudFrames, as_cloud
from ..observe.floors_and_walls import without_room
from ..observe.planes import Plane
from ..value_checks import check_direction, check_rate
from .advance import FirstSearch, Search, advance_frame, find_first_frame, make_follower
from .ahead import Ahead
from .check_cloud import check_cloud
from .judge_frame import TrackedFrame
from .missing import has_begun, missing_frame
from .people.other_people import shows_others
from .track_frame import Tracker, check_sigma, make_tracker

#: largest numbers of frames and reasons named in a sentence
MAX_NAMED_FRAMES, MAX_NAMED_REASONS = 20, 4


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
    planes: Sequence[Plane] | None = None,
    look_ahead: bool | None = None,
) -> Iterator[TrackedFrame]:
    """Track a stream of clouds; yield each frame as soon as it is done.

    **Arguments:** `start` is the pose to begin at, rest where not given, or the last `TrackedFrame` of an
    interrupted run; `search`: find the first pose by `initialise` if `start` does not explain the first cloud
    ("auto"), always (true) or never (false); `sigma` metres is the initial standard deviation of the first
    frame (Kineben's sigma0); `up` is the vertical of the scene; `first` is the number of the first cloud, so
    that a resumed run searches as an uninterrupted one; `on_search` is called before every search;
    `candidates(number)` gives other candidate poses of a frame: the frame keeps the likeliest, and leaves the
    tracked pose only for one with a mean log-likelihood better by more than `margin`; `planes`, floors and walls whose points
    are removed: by default those of the first cloud (`jc.observe.find_room`), none for an empty list; `look_ahead`, take each cloud
    before the frame before it is yielded, so that it is tracked while that one is judged: by default for sequences, and not for iterators,
    which may be live.

    A frame is judged by the points that no part explains and by the surface without points in view of a
    sensor, compared with the baseline of the previous frames. A frame that is not good is fitted again from a few hypotheses of
    a fast motion (`catch_up`), and then searched for
    from many starts; after a search without success the next one waits, twice as long each time. A frame that
    nothing explains is `lost`, and tracking goes on. So is a frame that shows no person (`missing_cloud`): it keeps the
    last pose that was not lost.

    **Raises:** `InputError` for an invalid `sigma` or `up`, and, when its turn comes, for a cloud with fewer
    points than the pose has parameters, or in another unit.
    """
    check_sigma("track_frames", sigma)
    check_direction("track_frames", up=up)
    if tracker.terms and isinstance(start, Pose):
        check_finite_residuals("track_frames", Sum(tracker.terms), tracker.body, start)
    return _track_frames(
        tracker, clouds, start, search, sigma, up, first, on_search, candidates, margin, planes, look_ahead
    )


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
    planes: Sequence[Plane] | None,
    look_ahead: bool | None,
) -> Iterator[TrackedFrame]:
    """Track as `track_frames` does, after its checks."""
    forget_many_compiled()
    follower = make_follower(tracker, up, on_search)
    frame = start if isinstance(start, TrackedFrame) else None
    # where the first frame with a person starts
    pose = rest_pose(tracker.body.skeleton) if start is None else start
    pose = pose.trusted if isinstance(pose, TrackedFrame) else pose
    is_recorded = isinstance(clouds, (Sequence, Cloud)) if look_ahead is None else look_ahead
    ahead = Ahead(tracker) if is_recorded else None
    every = without_room(iterate_clouds(clouds), planes)
    for number, cloud in enumerate(every if ahead is None else ahead.with_next(every), first):
        if cloud.missing:
            frame = missing_frame(tracker, follower.surface, cloud, frame, pose)
            yield frame
            continue
        check_cloud(tracker.body, cloud, f"cloud {number}")
        likely = None if candidates is None else candidates(number)
        if frame is None or not has_begun(frame):
            frame = find_first_frame(
                follower, cloud, pose, number, search=search, sigma=sigma, candidates=likely, margin=margin
            )
        else:
            frame = advance_frame(
                follower, frame, cloud, number, candidates=likely, margin=margin, ahead=ahead
            )
        others = shows_others(follower, frame.pose, cloud, float(frame.statistics.outlier_share))
        frame = dataclasses.replace(frame, others=others)
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
    frames, with their faults, parts of the body without points, and frames that show another person;
    `track_frames` gives the verdict on each frame. The points of floors and walls
    in the first cloud are removed from all clouds.

    **Raises:** `InputError` for a cloud with fewer points than the pose has parameters, or in another unit.
    """
    if tracker is not None and terms != ():
        raise InputError(
            "track: `terms` and `tracker` were both given; give the terms to make_tracker(body, terms=...)."
        )
    check_rate("track", rate)
    tracker = make_tracker(body, terms=terms) if tracker is None else tracker
    poses, verdicts, unseen, others = [], [], [], []
    for frame in track_frames(tracker, clouds, start, search=search, sigma=sigma, up=up):
        # copies in NumPy: a JAX array has an overhead of a kilobyte
        poses.append(jax.tree.map(np.array, frame.pose))
        verdicts.append((frame.verdict, frame.reasons))
        unseen.append(frame.unseen)
        others.append(frame.others)
    for sentence in (*verdict_sentences(verdicts), *unseen_sentences(unseen), *others_sentences(others)):
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
        named = name_frames(numbers)
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


def others_sentences(others: Sequence[bool]) -> list[str]:
    """Describe the frames that show more than one person; without a full stop.

    **Arguments:** `others` of every `TrackedFrame`.
    """
    numbers = [number for number, found in enumerate(others) if found]
    if not numbers:
        return []
    return [
        f"{len(numbers)} of {len(others)} frames show something else of a person's size, which may be another person: "
        f"{name_frames(numbers)}, counted from 0; its points are outliers; track several people with track_people or --people"
    ]


def name_frames(numbers: Sequence[int]) -> str:
    """List frames by their numbers, at most `MAX_NAMED_FRAMES`."""
    more = " and more" if len(numbers) > MAX_NAMED_FRAMES else ""
    return ", ".join(map(str, numbers[:MAX_NAMED_FRAMES])) + more


def iterate_clouds(clouds: Iterable[Cloud | Scan] | Cloud) -> Iterator[Cloud]:
    """Iterate over frames, also of scans as read from files, and of one cloud stacked over frames."""
    if isinstance(clouds, (Cloud, Scan)):
        return iter(CloudFrames(clouds))  # pyright: ignore[reportArgumentType] - a scan is refused there
    return (as_cloud(cloud, number) for number, cloud in enumerate(clouds))
