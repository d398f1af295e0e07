"""`jaxcap track`: fit a body to a sequence of clouds."""

import dataclasses
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from ...body.body import Body
from ...body.pose import Motion
from ...energy.data.floor import make_measured_floor
from ...energy.energy import AbstractEnergy
from ...errors import InputError, user_message
from ...io.archives.journal import Journal
from ...io.lazy_frames import LazyFrames
from ...io.system.run_lock import run_lock
from ...observe.clouds import Cloud
from ...observe.planes import Plane
from ...tracking.advance import FirstSearch
from ...tracking.chunks.division import divide_frames
from ...tracking.chunks.tasks import TrackSettings
from ...tracking.expectation_maximisation.em_step import make_mixture_settings
from ...tracking.judge_frame import TrackedFrame
from ...tracking.people.track_people import MAX_PEOPLE
from ...tracking.track import track_frames
from ...tracking.track_frame import Tracker, make_tracker, replace_body
from ..body_models import load_model_of, write_parameters
from ..console.console import pluralise, progress, say, warn
from ..console.heartbeat import set_activity
from ..console.options import (
    BodySpec,
    CloudsSpec,
    DepthSpec,
    Flag,
    KeepPlanes,
    NumChunks,
    OptionalCount,
    Scheduler,
    Skl,
    Unit,
    Up,
    Vj,
    Workers,
    arg,
)
from ..console.timed import timed
from ..depth.sources import (
    BackgroundChoice,
    Cameras,
    DepthScale,
    Empty,
    Masks,
)
from ..scan.rate import Rate, ScanRate, find_rate, print_rate
from ..sources import load_body, print_room
from ..terms import FloorHeight, LimitsFile, LimitWeight, PriorFile, print_floor, read_terms
from .advice import advise
from .announce import make_announcer, warn_without_prior
from .check_options import check_options, is_in_chunks
from .chunk_files import ChunkedRun
from .chunks import ChunkOptions, track_in_chunks
from .depth import (
    BACKGROUND_KEY,
    announce_blind,
    announce_missing,
    check_some_person,
    describe_distance,
)
from .deviations import find_deviations, good_frames, own_cloud
from .frame_records import pack, pose_layout, results_width, row_template, row_width, unpack_results
from .input import FLOOR_KEY, floor_below_person, open_input
from .people import follow_people, people_template, read_count, write_people
from .people_deviations import divide_clouds
from .person_shape import find_shapes
from .results import (
    CHUNKS,
    PARAMETERS,
    REPORT,
    check_complete,
    check_folder,
    check_some_found,
    fingerprint,
    last_frame,
    make_writable,
    open_journal,
    warn_of_results,
    write_results,
)

JOURNAL = "journal"
#: key of its header, with which a run in chunks is not continued as one run
IN_CHUNKS = "in chunks"
People = Annotated[str | None, arg(metavar="N", help_behavior_hint="")]
#: values of --initialise
SEARCHES: dict[str, FirstSearch] = {"auto": "auto", "always": True, "never": False}

#: options that affect the result
SETTINGS = (
    "normal_angle", "sigma0", "outlier", "damping", "iterations", "limit_weight", "depth_scale", "vertices", "unit", "up",
    "estimate_priors", "initialise", "partial", "clothes", "keep_planes", "fit_shape", "background", "people",
)  # fmt: skip


@dataclass
class Track:
    """Fit a body to a sequence of point clouds or depth images; write motion.bvh, motion.npz, and the statistics of
    each frame in statistics.csv and statistics.json.

    An interrupted run continues with --resume. The result is the same as without the interruption."""

    body: BodySpec
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output folder."""
    clouds: CloudsSpec = ()
    depth: DepthSpec = ()
    """Depth images instead of CLOUDS: for each camera a folder, a quoted glob ('cam0/*.png', 16 bits) or an .npz with
    the array `depth` (F, H, W). The person is found in each image, unless --masks is given or the .npz has an array
    `mask` (F, H, W)."""
    cameras: Cameras = None
    masks: Masks = ()
    empty: Empty = ()
    background: BackgroundChoice = "auto"
    depth_scale: DepthScale = 1000.0
    partial: Flag = False
    """The clouds show only a part of the body. A prior of human poses then determines the other joints, and a
    self-collision term keeps limbs out of other parts. --depth implies this option."""
    clothes: Flag = False
    """Learn which parts of the body wear loose clothes, such as a skirt. This option implies --partial."""
    keep_planes: KeepPlanes = False
    people: People = None
    """Track several people in the same clouds: their largest number, or `auto` to find it. The clouds must not contain
    furniture. The results of each person are written to a folder of its own, person_1 and so on."""
    fit_shape: Flag = False
    """Estimate the shape of the person from the first 40 frames before tracking, write it to person.npz, and track with it;
    with --people, of each person who is in them. BODY must be a body model or have the joints of the embedded human, as `human` does."""
    deviations: Flag = False
    """With --fit-shape, also write the standard deviations of coefficients and joints to parameters.npz."""
    skl: Skl = None
    vj: Vj = None
    limits: LimitsFile = None
    prior: PriorFile = None
    floor: FloorHeight = None
    limit_weight: LimitWeight = 100.0
    first: OptionalCount = None
    """First frame: the number in the file names of a pattern, otherwise counted from 0."""
    last: OptionalCount = None
    """Last frame, inclusive."""
    unit: Unit = "m"
    """Unit of the clouds, and of BODY if it is a mesh: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of the clouds, and of BODY if it is a mesh. Results have y up."""
    rate: ScanRate = None
    normal_angle: float = 60.0
    """Largest angle between the normal of a point and that of the vertex matched to it, degrees."""
    sigma0: float = 0.1
    """Initial standard deviation of the distances from the points of the first frame to the body, metres."""
    outlier: float = 0.1
    """Expected share of points that are not on the body."""
    damping: float = 1.0
    """Constant added to the diagonal of the normal equations, to damp the steps of the solver."""
    iterations: OptionalCount = None
    """Number of iterations of expectation maximisation per frame. Default: 4, and up to 12 while they move the surface far; 6 with --depth, --partial or --clothes."""
    vertices: OptionalCount = None
    """Reduce the body to about N vertices, for speed."""
    estimate_priors: Flag = False
    """Also estimate, for each body part, its share of the points."""
    workers: Workers = None
    scheduler: Scheduler = None
    chunks: NumChunks = None
    initialise: Literal["auto", "always", "never"] = "auto"
    """Search for the pose of the first frame: if the rest pose does not explain the first cloud (auto), always, or
    never. Without a search, tracking starts at the rest pose."""
    resume: Flag = False
    """Continue an interrupted run."""
    overwrite: Flag = False
    """Replace the results of an earlier run."""

    def run(self) -> None:
        check_options(self)
        if self.scheduler is not None:
            # workers have other working folders
            for name in ("clouds", "depth", "masks", "empty"):
                setattr(self, name, tuple(map(os.path.abspath, getattr(self, name))))
        body, limits = load_body(
            self.body, self.skl, self.vj, self.limits, vertices=self.vertices, unit=self.unit, up=self.up
        )
        terms = read_terms(
            body, limits=limits, limit_weight=self.limit_weight, floor=self.floor, prior=self.prior
        )
        rate = find_rate(self.rate, self.clouds, self.depth)
        others: set[int] = set()
        found = open_input(self, body, others, self.out / JOURNAL)
        clouds = found.clouds
        # the first cloud shows most input errors, before any file is written
        begun = clouds[0]
        clouds = clouds.with_loaded(0, begun)
        check_some_person(clouds, begun)
        if self.chunks is not None:
            divide_frames(len(clouds), self.chunks)
        make_writable(self.out)
        print_rate(rate)
        for doubt in (*found.doubts, *describe_distance(begun)):
            warn(doubt)
        planes = print_room(begun, self.keep_planes)
        floor = None
        if self.floor is None:
            floor = floor_below_person(found._replace(clouds=clouds), planes, self.out / JOURNAL, self.resume)
            print_floor(floor)
            terms += () if floor is None else (make_measured_floor(body, floor),)
        tracker = self.tracker(body, terms)
        with run_lock(self.out):
            journal = check_folder(self.out, JOURNAL, self.resume, self.overwrite)
            trackers = self.trackers(tracker, clouds)
            header = {
                **self.settings(),
                **fingerprint(trackers, begun),
                **pose_layout(body.skeleton),
                BACKGROUND_KEY: found.images,
                FLOOR_KEY: None if floor is None else [*floor.normal.tolist(), floor.offset],
                **({IN_CHUNKS: True} if is_in_chunks(self) else {}),
            }
            if self.people is None:
                self.track(journal, trackers[0], clouds, rate, header, others, planes)
            else:
                self.track_people(journal, trackers, clouds, rate, header, planes)

    def trackers(self, tracker: Tracker, clouds: LazyFrames[Cloud]) -> list[Tracker]:
        """Make the tracker of each person, with --fit-shape of the own shape."""
        count = 1 if self.people is None else read_count(self.people)
        if not self.fit_shape:
            return [tracker] * (count or MAX_PEOPLE)
        model = load_model_of(self.body, self.vertices)
        bodies = find_shapes(self.out, model, tracker, clouds, count, several=self.people is not None)
        return [replace_body(tracker, body) for body in bodies]

    def track(
        self,
        path: Path,
        tracker: Tracker,
        clouds: LazyFrames[Cloud],
        rate: Rate,
        header: dict[str, object],
        others: set[int],
        planes: Sequence[Plane],
    ) -> None:
        """Track all frames that the journal at `path` lacks, and write the results, while the lock excludes other
        runs in the folder. `others` has the frames that show a second person, once they are read."""
        body = tracker.body
        template = row_template(tracker, num_cameras=len(self.depth))
        with open_journal(path, header, row_width(template), self.resume) as journal:
            last = last_frame(journal, clouds.names, template)
            if is_in_chunks(self):
                options = ChunkOptions(self.workers, self.scheduler, self.chunks)
                settings = TrackSettings(SEARCHES[self.initialise], self.sigma0, planes=planes)
                folder, cameras = self.out.absolute() / CHUNKS, len(self.depth)
                run = ChunkedRun(tracker, clouds, others, settings, folder, header, cameras)
                track_in_chunks(run, options, journal, self.out / REPORT)
            else:
                self.track_remaining(
                    self.steps(tracker, clouds, journal.count, last, others, planes), clouds, journal
                )
        set_activity("writing the results")
        rows = journal.read(slice(results_width(template)))[: len(clouds)]
        results = unpack_results(template, rows)
        write_results(self.out, body.skeleton, results, rate.frames, clouds.names)
        known = None
        if self.deviations:
            good, model = good_frames(results.verdicts), load_model_of(self.body, self.vertices)
            cloud = partial(own_cloud, clouds, planes)
            known = find_deviations(tracker, model, cloud, results.poses, good)
        motion = Motion(results.poses, rate.frames)
        write_parameters(self.out / PARAMETERS, self.body, body, motion, self.vertices, known)
        say(
            f"{pluralise(len(rows), 'frame')} in {results.seconds.sum():.1f} s: motion.bvh, motion.npz, statistics.csv and "
            f"statistics.json are in {self.out}"
        )
        warn_of_results(results, of_clouds=not self.depth)
        if len(rows) == len(clouds) and self.initialise != "never":
            advise(tracker, clouds, planes, results, self.up, fits_shape=self.fit_shape)
        check_some_found(self.out, results.verdicts)
        check_complete(len(rows), clouds)

    def track_people(
        self,
        path: Path,
        trackers: Sequence[Tracker],
        clouds: LazyFrames[Cloud],
        rate: Rate,
        header: dict[str, object],
        planes: Sequence[Plane],
    ) -> None:
        """Track several people as `track` does one body."""
        template = people_template(trackers, len(self.depth))
        # with own shapes, the number of people is known
        count = len(trackers) if self.fit_shape else read_count(str(self.people))
        with open_journal(path, header, row_width(template), self.resume) as journal:
            last = last_frame(journal, clouds.names, template)
            frames = follow_people(
                trackers,
                iter(clouds[journal.count :]),
                template,
                count,
                last,
                search=SEARCHES[self.initialise],
                sigma=self.sigma0,
                first=journal.count,
                announce=make_announcer(),
                planes=planes,
            )
            self.track_remaining(timed(frames), clouds, journal)
        set_activity("writing the results")
        rows = journal.read()[: len(clouds)]
        own = divide_clouds(trackers, template, rows, clouds, planes) if self.deviations else None
        where = self.out, trackers, template, rows, rate.frames, clouds.names
        write_people(*where, self.body, self.vertices, own)
        check_complete(len(rows), clouds)

    def settings(self) -> dict[str, object]:
        """Collect the settings that affect the result, by the names of the options."""
        return {name: getattr(self, name) for name in SETTINGS}

    def tracker(self, body: Body, terms: tuple[AbstractEnergy, ...]) -> Tracker:
        mixture = make_mixture_settings(
            normal_threshold=float(np.cos(np.radians(self.normal_angle))),
            outlier=self.outlier,
            damping=self.damping,
            estimate_priors=self.estimate_priors,
        )
        partial = self.partial or self.clothes or bool(self.depth)
        steps = self.iterations
        made = make_tracker(body, mixture, terms, iterations=steps, partial=partial, clothes=self.clothes)
        return warn_without_prior(made) if partial else made

    def track_remaining(self, steps: Iterator[tuple], clouds: LazyFrames[Cloud], journal: Journal) -> None:
        """Append the frames of all `steps` to the journal, each with its seconds; Ctrl-C stops early."""
        try:
            for frame, took in progress(steps, len(clouds), min(journal.count, len(clouds))):
                journal.append(pack(frame, took, clouds.names[journal.count]))
        except KeyboardInterrupt:
            if not journal.count:
                journal.path.unlink()
                raise
        except InputError as error:
            kept = f" The {journal.count} previous frames are kept; correct the input and give --resume to continue."
            raise InputError(f"{user_message(error)}{kept}") from None

    def steps(
        self,
        tracker: Tracker,
        clouds: LazyFrames[Cloud],
        begin: int,
        last: TrackedFrame | None,
        others: set[int],
        planes: Sequence[Plane],
    ) -> Iterator[tuple[TrackedFrame, float]]:
        """Yield the frames from `begin` on, each with its computing time in seconds."""
        frames = track_frames(
            tracker,
            announce_blind(announce_missing(iter(clouds[begin:]))),
            last,
            search=SEARCHES[self.initialise],
            sigma=self.sigma0,
            first=begin,
            on_search=make_announcer(),
            planes=planes,
            look_ahead=True,
        )
        for number, (frame, seconds) in enumerate(timed(frames), begin):
            yield dataclasses.replace(frame, others=frame.others or number in others), seconds
