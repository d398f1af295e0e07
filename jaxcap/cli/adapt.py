"""`jaxcap adapt`: the body becomes the actor of a sequence of scans."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import jax.numpy as jnp
import numpy as np

from ..adapt.evaluate import Stages, compare_stages, quantile, variant_names
from ..adapt.loop import AdaptState, Settings, Task, adapt_body, plan
from ..adapt.people import People, learn_people
from ..body.anatomy import rest_deviations
from ..body.body import Body
from ..body.pose import Pose
from ..body.skeleton import Skeleton
from ..body.variety import human_resolution, people_of_many_shapes
from ..edit.joint_names import twin_joints
from ..edit.retarget import retarget
from ..energy.pair_prior import MahalanobisPrior
from ..energy.prior import RestPrior
from ..energy.term import AbstractEnergy
from ..errors import InputError
from ..io.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from ..io.clouds import Scans, read_clouds
from ..io.npz import save_body
from ..io.prior import load_prior
from ..io.registry import MOTION_WRITERS, read_motion, write_motion
from ..report.adaptation import report_adaptation
from .options import BodySpec, CloudsSpec, Flag, OptionalCount, OptionalFile, Unit, Up, arg
from .results import make_writable
from .rounds import Rounds
from .say import say, warn
from .sources import load_body, load_cloud

#: bodies that tell how people differ
PEOPLE = 200


@dataclass
class Adapt:
    """Adapt a template body to the actor in a sequence of scans; writes the actor's own body and its motion.

    Scans need not be registered, whole or clean. A run that was stopped goes on with --resume."""

    body: BodySpec
    """The template: `human` (with options: `human:female,height=1.7`) or a body .npz."""
    clouds: CloudsSpec
    """A printf pattern (`scan_%03d.ply`), a quoted glob, a folder, or an .npz."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="OUT")]
    """The actor's body, .npz."""
    motion: Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")] = None
    """The motion, .bvh or .npz; beside the body where not given."""
    start: OptionalFile = None
    """A motion whose first pose is near that of the first scan; searched for where not given."""
    prior: OptionalFile = None
    """Which poses are likely, as `jaxcap prior learn` wrote it; beside what anatomy says."""
    report: OptionalFile = None
    """Also write what the adaptation has brought, as a page of pictures and tables, .html."""
    report_every: Annotated[int, arg(metavar="N")] = 1
    """Measure every N-th frame for the report, for speed."""
    frames: Annotated[int, arg(metavar="N")] = 40
    """Scans that the body is adapted to, spread over the motion."""
    joint_deviation: Annotated[float, arg(metavar="METRES")] = 0.005
    """How far joints may be from where the surface around them says; less where poses do not tell joints."""
    smoothness: Annotated[float | None, arg(metavar="WEIGHT", help_behavior_hint="")] = None
    """Weight of smooth motion; balanced with the scans where not given, 0 leaves it out."""
    first: OptionalCount = None
    """First frame: the number in a pattern's names, else counted from 0."""
    last: OptionalCount = None
    """Last frame, included."""
    unit: Unit = "m"
    """Unit of the scans: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Axis that points up in the scans. Results have y up."""
    rate: float = 30.0
    """Frames a second."""
    vertices: OptionalCount = None
    """Reduce the template to about so many vertices, for speed."""
    resume: Flag = False
    """Go on with a run that was stopped."""
    overwrite: Flag = False
    """Replace the results of an earlier run."""

    def run(self) -> None:
        self.check()
        body, _ = load_body(self.body, vertices=self.vertices)
        scans = read_clouds(self.clouds, self.first, self.last, self.unit)
        if len(scans) < 3:
            raise InputError(f"{self.clouds}: {len(scans)} scans are too few to adapt to; give at least 3.")
        # the first scan shows most of what may be wrong, before anything is written
        load_cloud(scans, 0, body, self.up)
        task = self.task(body, scans)
        header = {**self.settings(), **_fingerprint(body, scans)}
        state = self.begin(header, body)
        stages = plan(task.settings)
        with Rounds(len(stages), 0 if state is None else state.done, "adapting") as bar:
            try:
                for reached in adapt_body(task, state):
                    state = reached
                    save_checkpoint(self.kept, checkpoint_of(state), header)
                    bar.tell(
                        state.done,
                        f"{stages[state.done - 1]}: {state.history[-1][1]:.2f} mm from scan to body",
                    )
            except KeyboardInterrupt:
                done = 0 if state is None else state.done
                told = (
                    f"{done} stages are kept in {self.kept}; --resume goes on"
                    if done
                    else "no stage was done"
                )
                raise KeyboardInterrupt(f"stopped; {told}") from None
        assert state is not None
        save_body(self.out, state.body)
        write_motion(self.motion_path, state.body.skeleton, state.motion)
        say(
            f"{self.out}: {len(state.body.vertices)} vertices, {state.size:.3f} times the template's size; "
            f"{state.history[-1][1]:.2f} mm from scan to body; {len(state.motion)} poses in {self.motion_path}"
        )
        if state.lost:
            warn(
                f"{len(state.lost)} of {len(state.motion)} frames were lost: {', '.join(map(str, state.lost))}; counted from 0"
            )
        if self.report is not None:
            self.write_report(self.report, task, state)
        self.kept.unlink(missing_ok=True)

    def write_report(self, path: Path, task: Task, state: AdaptState) -> None:
        """Measure the result and those it is compared with. The checkpoint is still there, so that --resume does
        only this where it is stopped."""
        names, stages = variant_names(task.settings), Stages(())
        with Rounds(len(names), 0, "measuring") as bar:
            try:
                for stages in compare_stages(task, state, step=self.report_every):
                    done, near = len(stages.variants), quantile(stages.variants[-1].to_body, 0.5)
                    bar.tell(done, f"{names[done - 1]}: {1000 * near:.2f} mm from scan to body, median")
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    f"stopped; body and motion are there, --resume makes {path}"
                ) from None
        how = {
            "template": self.body,
            "scans": self.clouds,
            **self.settings(),
            "prior": self.prior,
            "start": self.start,
        }
        report_adaptation(path, task, state, stages, how)
        say(f"{path}: the report")

    @property
    def kept(self) -> Path:
        """The checkpoint."""
        return self.out.with_name(self.out.name + ".partial")

    @property
    def motion_path(self) -> Path:
        return self.motion or self.out.with_name(self.out.stem + "-motion.npz")

    def check(self) -> None:
        """That options are in their ranges and results can be written. Raises `InputError`."""
        wrong = {
            "--frames": (self.frames, self.frames >= 2, "at least 2"),
            "--joint-deviation": (
                self.joint_deviation,
                0 < self.joint_deviation < 1,
                "above 0 and below 1 metre",
            ),
            "--smoothness": (self.smoothness, self.smoothness is None or self.smoothness >= 0, "at least 0"),
            "--report-every": (self.report_every, self.report_every >= 1, "at least 1"),
            "--rate": (self.rate, 0 < self.rate < np.inf, "above 0 frames a second"),
        }
        for name, (value, fine, what) in wrong.items():
            if not fine:
                raise InputError(f"{name} is {value:g}; it must be {what}.")
        if self.out.suffix.lower() != ".npz":
            raise InputError(f"{self.out}: bodies are written as .npz; give a name that ends in it.")
        if self.motion_path.suffix.lower() not in MOTION_WRITERS:
            raise InputError(
                f"{self.motion_path}: motions are not written as '{self.motion_path.suffix}' files; use "
                f"{', '.join(MOTION_WRITERS)}."
            )
        if self.report is not None and self.report.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"{self.report}: the report is a page; give a name that ends in .html.")
        if self.resume and self.overwrite:
            raise InputError("--resume goes on with a run and --overwrite replaces it; give one of them.")
        there = [
            path for path in (self.out, self.motion_path, self.report) if path is not None and path.exists()
        ]
        if there and not (self.overwrite or self.resume):
            raise InputError(f"{there[0]}: this file is there already; give --overwrite to replace it.")
        if self.report is not None:
            make_writable(self.report.absolute().parent)

    def task(self, body: Body, scans: Scans) -> Task:
        skeleton = body.skeleton
        prior: AbstractEnergy = RestPrior(jnp.asarray(rest_deviations(skeleton, 1.0), body.vertices.dtype))
        if self.prior is not None:
            prior = prior + MahalanobisPrior(load_prior(self.prior, skeleton))
        return Task(
            template=body,
            cloud=lambda frame: load_cloud(scans, frame, body, self.up),
            frames=len(scans),
            rate=self.rate,
            start=None if self.start is None else first_pose(self.start, skeleton),
            prior=prior,
            mirrored=mirrored_joints(skeleton),
            settings=Settings(frames=self.frames, joint=self.joint_deviation, temporal=self.smoothness),
            people=people_like(body),
        )

    def settings(self) -> dict[str, object]:
        """What the result depends on, by the names that the user knows."""
        names = ("frames", "joint_deviation", "smoothness", "unit", "up", "rate", "vertices", "first", "last")
        prior = None if self.prior is None else hashlib.sha256(self.prior.read_bytes()).hexdigest()
        return {**{name: getattr(self, name) for name in names}, "prior": prior}

    def begin(self, header: dict[str, object], template: Body) -> AdaptState | None:
        """The state to go on from. Raises `InputError` where there is none to resume, or one in the way."""
        if self.resume:
            if not self.kept.is_file():
                raise InputError(
                    f"{self.kept}: there is no unfinished run to go on from; leave --resume out."
                )
            return state_of(load_checkpoint(self.kept, header, ("done", "size", "lost", "chosen", "traits")))
        if self.kept.exists() and not self.overwrite:
            raise InputError(
                f"{self.kept}: an unfinished run is there; give --resume to go on with it or --overwrite to begin anew."
            )
        return None


def people_like(template: Body) -> People | None:
    """How people differ, where the template has the human's triangles and joints."""
    resolution = human_resolution(template)
    if resolution is None:
        return None
    return learn_people(template, people_of_many_shapes(PEOPLE, resolution=resolution, joints="tracking"))


def first_pose(path: Path, skeleton: Skeleton) -> Pose:
    """The first pose of a motion, carried over to a skeleton of other proportions. Raises `InputError`."""
    of, motion = read_motion(path)
    try:
        return retarget(motion.slice(slice(1)), of, skeleton)[0]
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def mirrored_joints(skeleton: Skeleton) -> tuple[tuple[int, int], ...]:
    """Pairs of joints of the left and the right, each joint in one of them at most."""
    found: list[tuple[int, int]] = []
    for pair in twin_joints(skeleton.names):
        if not any(joint in other for other in found for joint in pair):
            found.append(pair)
    return tuple(found)


def checkpoint_of(state: AdaptState) -> Checkpoint:
    """A state as a file can hold it."""
    arrays = {
        "done": np.array(state.done),
        "size": np.array(state.size, float),
        "lost": np.array(state.lost, int),
        "chosen": np.array(state.chosen, int),
        "traits": np.array(state.traits, float),
    }
    return Checkpoint(state.body, state.motion, state.history, arrays)


def state_of(kept: Checkpoint) -> AdaptState:
    """The state of a checkpoint that `checkpoint_of` made, to the last bit."""
    arrays = kept.arrays
    lost, chosen, traits = (tuple(arrays[name].tolist()) for name in ("lost", "chosen", "traits"))
    return AdaptState(
        int(arrays["done"]), kept.body, float(arrays["size"]), kept.motion, lost, chosen, kept.history, traits
    )


def _fingerprint(body: Body, scans: Scans) -> dict[str, object]:
    """What tells that inputs are the same."""
    first = hashlib.sha256(np.ascontiguousarray(scans[0].points).tobytes())
    shape = hashlib.sha256(np.ascontiguousarray(body.vertices).tobytes())
    return {"template": shape.hexdigest(), "first cloud": first.hexdigest(), "scans": len(scans)}
