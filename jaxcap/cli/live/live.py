"""`jaxcap live`: track a person as frames arrive."""

import sys
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from ...depth.background import Background
from ...depth.stream.cloud_stream import NUM_POINTS
from ...errors import InputError, user_message
from ...io.archives.journal import Journal, create_journal
from ...io.depth.sequence import DepthFrame
from ...io.system.run_lock import run_lock
from ...live.live_tracker import LiveTracker, make_live_tracker
from ...live.statistics import LiveFrame
from ...observe.clouds import Scan
from ...tracking.judge_frame import TrackedFrame
from ...tracking.track import unseen_sentences, verdict_sentences
from ...tracking.track_frame import Tracker
from ..console.compiled import count_kept_functions
from ..console.console import pluralise, say, warn
from ..console.heartbeat import set_activity, write_status
from ..console.options import BodySpec, DepthSpec, Flag, OptionalCount, OptionalFile, Skl, Unit, Up, Vj, arg
from ..depth.sources import DepthScale, read_empty
from ..sources import load_body
from ..terms import FloorHeight, LimitsFile, LimitWeight, PriorFile, print_floor, read_terms
from ..track.frame_records import pack, pose_layout, results_width, row_template, row_width, unpack_results
from ..track.results import check_folder, check_some_found, make_writable, write_results
from ..track.track import JOURNAL
from .slots import fill_slots, frame_slots
from .sources import Source, observation, open_source

#: seconds between two statuses on a terminal, and between two lines elsewhere
STATUS_SECONDS, LINE_SECONDS = 0.5, 5.0
#: default rate of the written motion, frames per second
DEFAULT_RATE = 30.0
#: seconds for the last frame at the end
END_SECONDS = 60.0


@dataclass
class Live:
    """Track a body in depth images or clouds as they arrive; at the end write motion.bvh, motion.npz and the statistics of each
    frame, as `track` does.

    The newest frame is tracked; frames that a newer one overtakes are dropped. Ctrl-C ends the run. `jaxcap view OUT` shows it
    at the same time."""

    body: BodySpec
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """Output folder."""
    watch: Annotated[tuple[str, ...], arg(metavar="SOURCE...", help_behavior_hint="")]
    """Source of the frames: for each camera a folder to which images are added, `-` for a stream of .npy arrays on standard
    input, or `realsense` or `orbbec` for a connected camera. Without --cameras, a folder or a stream of clouds."""
    cameras: OptionalFile = None
    """Cameras of depth images, .json: intrinsics as written by Open3D, RealSense or OpenCV, or calibrated cameras as
    written by `jaxcap scan`. A connected camera states its own intrinsics."""
    replay: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")] = None
    """Replay recorded files, which --watch names as `track --depth` does, or clouds, at this rate, frames per second."""
    empty: DepthSpec = ()
    """Depth images that show nobody, for each camera a source as for `track --depth`: the background, which is not taken for
    the person. Without them floor and walls alone are known."""
    depth_scale: DepthScale = 1000.0
    rate: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")] = None
    """Frames per second of the written motion; dropped frames are interpolated. Default: the rate of --replay, else 30."""
    num_points: int = NUM_POINTS
    """Largest number of points of a frame. Flat parts of the surface are thinned first."""
    iterations: OptionalCount = None
    """Number of iterations of expectation maximisation per frame. Default: 3."""
    vertices: OptionalCount = None
    """Reduce the body to about N vertices, for speed."""
    timeout: Annotated[float | None, arg(metavar="SECONDS", help_behavior_hint="")] = None
    """End the run after this time without a new file in a watched folder. Default: never."""
    partial: Flag = False
    """The clouds show only a part of the body, as for `track`. Depth images imply this option."""
    clothes: Flag = False
    """Learn which parts of the body wear loose clothes, as for `track`. This option implies --partial."""
    no_search: Flag = False
    """Do not search for a body that is lost; tracking starts at the rest pose."""
    skl: Skl = None
    vj: Vj = None
    limits: LimitsFile = None
    prior: PriorFile = None
    floor: FloorHeight = None
    limit_weight: LimitWeight = 100.0
    unit: Unit = "m"
    """Unit of the clouds, and of BODY if it is a mesh: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of the clouds or cameras, and of BODY if it is a mesh. Results have y up."""
    overwrite: Flag = False
    """Replace the results of an earlier run."""

    def run(self) -> None:
        self.check()
        body, limits = load_body(
            self.body, self.skl, self.vj, self.limits, vertices=self.vertices, unit=self.unit, up=self.up
        )
        terms = read_terms(
            body, limits=limits, limit_weight=self.limit_weight, floor=self.floor, prior=self.prior
        )
        make_writable(self.out)
        with run_lock(self.out):
            path = check_folder(self.out, JOURNAL, False, self.overwrite, resumable=False)
            stop = threading.Event()
            source = open_source(
                self.watch,
                self.cameras,
                self.replay,
                self.depth_scale,
                self.unit,
                self.up,
                self.timeout,
                stop,
            )
            if self.empty and not source.cameras:
                raise InputError("--empty is for depth images; give --cameras.")
            backgrounds = None
            if self.empty:
                backgrounds = read_empty(source.cameras, source.recorded, self.empty, self.depth_scale)
            partial = self.partial or self.clothes or bool(source.cameras)
            tracker = make_live_tracker(
                body, terms, partial=partial, iterations=self.iterations, clothes=self.clothes
            )
            template = row_template(tracker, num_cameras=len(source.cameras))
            with create_journal(path, pose_layout(body.skeleton), row_width(template)) as journal:
                run = LiveRun(tracker, source, backgrounds, journal, self)
                run.follow(stop)
                set_activity("writing the results")
                self.write(template, tracker, journal, run)

    def check(self) -> None:
        """Check that options are in range. Raises `InputError`."""
        numbers = {
            "--replay": (self.replay, "frames per second"),
            "--rate": (self.rate, "frames per second"),
            "--timeout": (self.timeout, "seconds"),
            "--depth-scale": (self.depth_scale, "units in a metre"),
        }
        for name, (value, unit) in numbers.items():
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} is {value:g}; it must be above 0 {unit}.")
        for name, value in {"--num-points": self.num_points, "--iterations": self.iterations}.items():
            if value is not None and value < 1:
                raise InputError(f"{name} is {value}; it must be at least 1.")
        if not self.watch:
            raise InputError("--watch names no source; give a folder, '-', realsense or orbbec.")

    def write(self, template: TrackedFrame, tracker: Tracker, journal: Journal, run: "LiveRun") -> None:
        """Write the motion and the statistics of the run, and print a summary. Raises `InputError` if it has no frames."""
        rows = journal.read(slice(results_width(template)))
        if not len(rows):
            failure = run.statistics.last_failure
            journal.path.unlink()
            raise InputError(
                f"{self.out}: no frame was tracked, so nothing is written. "
                + (f"The last one failed: {failure}" if failure else "No frame arrived.")
            )
        rate = self.rate or self.replay or DEFAULT_RATE
        tracked = unpack_results(template, rows)
        seconds = np.array([frame[0] for frame in run.frames])
        results, names = fill_slots(tracked, [frame[1] for frame in run.frames], frame_slots(seconds, rate))
        summary = {"live": run.statistics._asdict()}
        write_results(self.out, tracker.body.skeleton, results, rate, names, summary)
        say(run.statistics.sentence())
        if run.statistics.reduced:
            warn(
                f"{run.statistics.reduced} of {run.statistics.tracked} frames were tracked at half the resolution of the images, as "
                "many frames were dropped; the computer is too slow for this rate, or other programs run."
            )
        say(
            f"{pluralise(len(names), 'frame')} at {rate:g} frames per second: motion.bvh, motion.npz, statistics.csv and "
            f"statistics.json are in {self.out}"
        )
        # numbers are those of the written motion
        for sentence in (*verdict_sentences(results.verdicts), *unseen_sentences(results.unseen)):
            warn(sentence)
        check_some_found(self.out, tracked.verdicts)


class LiveRun:
    """A live run: passes frames on, keeps them in the journal, and prints its status."""

    def __init__(
        self,
        tracker: Tracker,
        source: Source,
        backgrounds: Sequence[Background | None] | None,
        journal: Journal,
        options: Live,
    ):
        self.source, self.journal, self.options = source, journal, options
        #: time and name of each tracked frame
        self.frames: list[tuple[float, str]] = []
        self._live = LiveTracker(
            tracker,
            source.cameras,
            backgrounds=backgrounds,
            num_points=options.num_points,
            on_frame=self._keep,
            search=not options.no_search,
            find_floor=options.floor is None and bool(source.cameras),
        )
        self.statistics = self._live.statistics
        self._printed = 0.0
        self._failure = ""
        self._is_ready, self._has_counted = False, False
        #: the end of the last attempt to warm up, `time.monotonic()`
        self._since = -np.inf

    def follow(self, stop: threading.Event) -> None:
        """Track frames until the source ends or Ctrl-C."""
        live, up = self._live, self.options.up
        try:
            if self.source.sample is not None:
                self._warm_up(self.source.sample)
            set_activity("waiting for frames")
            for arrival in self.source.arrivals:
                # a frame that has arrived during an attempt is too old for the next one
                is_fresh = arrival.arrived >= self._since
                if is_fresh and not self._is_ready:
                    self._warm_up(arrival.read)
                elif is_fresh:
                    self._print_dropped()
                live.push(
                    lambda arrival=arrival: observation(arrival.read(), up),
                    arrival.seconds,
                    name=arrival.name,
                    arrived=arrival.arrived,
                )
                self._print_status()
            live.wait(END_SECONDS)
            self._print_dropped()
        except KeyboardInterrupt:
            warn("stopped; the frames so far are written")
        except InputError as error:
            if not self.frames:
                raise
            warn(f"{user_message(error)} The frames so far are written.")
        finally:
            stop.set()
            self.statistics = live.statistics
            live.close()

    def _warm_up(self, read: Callable[[], DepthFrame | Scan]) -> None:
        """Compile with a frame; one that cannot be read, or shows nobody, is reported and leaves this to a later one."""
        # the frames before use the same clouds
        self._live.wait(END_SECONDS)
        set_activity("compiling for the first frame")
        kept = count_kept_functions()
        try:
            frame = read()
            seconds = self._live.warm_up(observation(frame, self.options.up), frame.name)
            self._is_ready = True
            print_floor(self._live.floor)
            later = "; later starts are faster, as the compiled functions are kept"
            say(f"ready after {seconds:.1f} s{later if count_kept_functions() > kept else ''}")
        except InputError as error:
            if not self._failure:
                self._failure = user_message(error)
                warn(self._failure)
        self._since = time.monotonic()
        set_activity("waiting for frames")

    def _print_dropped(self) -> None:
        """Print once how many frames were dropped during compilation."""
        early = self._live.statistics.dropped_before_ready
        if early and not self._has_counted:
            say(
                f"{pluralise(early, 'frame')} that arrived during compilation {'was' if early == 1 else 'were'} dropped"
            )
        self._has_counted = True

    def _keep(self, frame: LiveFrame) -> None:
        """Write a tracked frame to the journal."""
        self.journal.append(pack(frame.tracked, frame.computed, frame.name))
        self.frames.append((frame.seconds, frame.name))

    def _print_status(self) -> None:
        now = time.monotonic()
        if now - self._printed < (STATUS_SECONDS if sys.stderr.isatty() else LINE_SECONDS):
            return
        self._printed, found = now, self._live.statistics
        if found.last_failure and found.last_failure != self._failure:
            self._failure = found.last_failure
            warn(found.last_failure)
        newest = self._live.newest
        verdict = "" if newest is None else f"; {newest.tracked.verdict}"
        search = ", searching" if self._live.is_searching else ""
        write_status(f"{found.sentence()}{verdict}{search}")
