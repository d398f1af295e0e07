"""What an adaptation is asked, what it has reached, and the stages in between (Adaptation, 4.1.4)."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from ..body.body import Body
from ..body.limits.rotation_vector_boxes import PoseBoxes
from ..body.pose import Motion, Pose
from ..energy.energy import AbstractEnergy, terms_of
from ..errors import InputError, sentence_of
from ..fit.correspondence.correspond import Matching, Scan, make_scan
from ..fit.tracking.recover import TrackedFrame
from ..fit.tracking.track_frame import Tracker, make_tracker
from ..geometry.camera import Camera
from ..observe import Cloud
from ..values import check_at_least, check_positive
from .objective import Terms
from .shape.shape_prior import ShapePrior
from .shape.shape_space import People

#: how often a body is adapted while it is tracked
TIMES = 10


class Settings(NamedTuple):
    """What adaptation may be told; weights are against the mean squared distance of a pair, metres squared, but for that
    of shape: against their sum, as the more scans there are the more they are to be believed."""

    #: frames that the body is adapted to, spread over the motion
    frames: int = 40
    #: rounds of joints with their skin, or of the traits of people where these are known, before vertices are adapted
    alone: int = 6
    #: rounds of vertices and joints in each pass
    rounds: tuple[int, ...] = (5, 6)
    #: weight of the Laplacian term in the first and the last round
    shape: tuple[float, float] = (100.0, 3.0)
    #: weight of the pose prior; None is a tenth of its balance with the data in the first frames (eq. 4.15)
    pose: float | None = None
    #: weight of second differences; None is a tenth of their balance with the data (eq. 4.16), 0 leaves them out
    temporal: float | None = None
    #: adapt while tracking, after every so many frames of the first `TIMES` as many (multi-time adaptation); with 0 all are
    #: tracked first and those adapted to that show most (guided adaptation)
    every: int = 0
    #: standard deviation of a joint from where the surface around it says, metres
    joint: float = 0.005
    #: the same of a pair's distance
    deviation: float = 0.003
    matching: Matching = Matching()
    #: vertices, joints and poses in one step of each round, and not one after the other
    together: bool = False
    #: scans do not follow each other in time: no term couples them, and each is searched for from those that are most like
    #: it; None is found by `make_task` from the scans
    unordered: bool | None = None

    @property
    def smooth(self) -> bool:
        """Whether the motion is made smooth in time."""
        return self.temporal != 0.0 and not self.unordered


def check_settings(settings: Settings) -> None:
    """Check that settings are in their ranges. Raises `InputError` for the first that is not."""
    where = "AdaptSettings"
    check_at_least(where, 1, frames=settings.frames)
    check_at_least(where, 0, alone=settings.alone, rounds=settings.rounds, every=settings.every)
    check_at_least(where, 0, shape=settings.shape, pose=settings.pose, temporal=settings.temporal)
    check_positive(where, "metres", joint=settings.joint, deviation=settings.deviation)


class AdaptState(NamedTuple):
    """What has been reached: enough to go on from, to the last bit."""

    #: stages that are done
    done: int
    body: Body
    #: the actor's size against the template's
    size: float
    #: poses of all frames
    motion: Motion
    #: frames that the body explains less well than is normal for them all, or that have no scan
    lost: tuple[int, ...] = ()
    #: frames that the body is being adapted to
    chosen: tuple[int, ...] = ()
    #: what each stage was, and the root mean square of a pair after it, millimetres
    history: tuple[tuple[str, float], ...] = ()
    #: what the actor has of the ways in which people differ, beyond the template; none before they are looked for
    traits: tuple[float, ...] = ()
    #: weight of the pose prior
    weight: float = 0.0
    #: what each term was worth after each stage, as the history has them
    terms: tuple[Terms, ...] = ()
    #: weight of second differences, once it is balanced
    temporal: float = 0.0
    #: frames of the stage that comes next which are done already
    within: int = 0
    #: the last of them, where it is one of tracking
    tracked: TrackedFrame | None = None
    #: why each of the `lost` frames is lost
    reasons: tuple[str, ...] = ()


class Task(NamedTuple):
    """What stays the same through all stages."""

    template: Body
    #: the cloud of a frame
    cloud: Callable[[int], Cloud]
    frames: int
    rate: float
    #: a pose near that of the first frame; None is searched for
    start: Pose | None
    prior: AbstractEnergy
    #: pairs of joints, left and right, whose bones stay equally long
    mirrored: tuple[tuple[int, int], ...]
    settings: Settings
    #: how people differ: those of the template's triangles tell more than it alone
    people: People | None = None
    #: the calibrated sensors, which stand still: vertices that none of them sees are in no pair; none say nothing
    cameras: tuple[Camera, ...] = ()
    #: frames without a scan that can be used, of which `cloud` is not asked; some others are there
    missing: tuple[int, ...] = ()
    #: the least and the largest turns of joints, which no pose goes beyond
    boxes: PoseBoxes | None = None
    #: what training meshes of the template show of its shape; else the template's own, or that of the person it became
    shape: ShapePrior | None = None
    #: further energies of every frame, in units of a log-likelihood
    terms: AbstractEnergy | None = None
    #: the scan of a frame with its triangles, where scans are meshes; of clouds it is made of their points
    mesh: Callable[[int], Scan] | None = None

    @property
    def scanned(self) -> list[int]:
        """Frames that have a scan."""
        return sorted(set(range(self.frames)) - set(self.missing))

    def frames_of(self, stage: "Stage") -> list[int]:
        """Frames with a scan that a stage goes through."""
        return [n for n in self.scanned if stage.frames is None or n < stage.frames] or self.scanned[:1]

    def scan(self, frame: int) -> Scan:
        """What pairs are found in. Raises `InputError` where the cloud of a frame has no points."""
        if self.mesh is not None:
            return self.mesh(frame)
        cloud = self.cloud(frame)
        try:
            return make_scan(cloud)
        except ValueError as error:
            raise InputError(
                f"frame {frame}: {sentence_of(error)} Name it among the `missing` frames."
            ) from None

    def some(self, frames: Sequence[int]) -> "Task":
        """The task of some of the frames, numbered from 0."""
        mesh = self.mesh
        return self._replace(
            cloud=lambda number: self.cloud(frames[number]),
            mesh=None if mesh is None else lambda number: mesh(frames[number]),
            frames=len(frames),
            missing=tuple(number for number, frame in enumerate(frames) if frame in self.missing),
        )


class Stage(NamedTuple):
    """One stage of an adaptation; in passes from 1, of rounds from 1: those of pass 0 are before any vertex is adapted."""

    name: str
    number: int = 0
    round: int = 0
    #: only so many frames from the first on
    frames: int | None = None

    def __str__(self) -> str:
        if self.frames is not None:
            return f"{self.name} to frame {self.frames}"
        if self.name != "adapt":
            return self.name
        return (
            f"pass {self.number}, round {self.round}" if self.number else f"proportions, round {self.round}"
        )


def plan(settings: Settings) -> list[Stage]:
    """The stages, in order."""
    stages = [Stage("size")]
    if settings.every:
        for time in range(1, TIMES + 1):
            stages.append(Stage("track", frames=time * settings.every))
            alone = time <= settings.alone // 2
            stages.append(Stage("adapt", 0 if alone else 1, time if alone else 1, time * settings.every))
    stages.append(Stage("track"))
    stages += [Stage("adapt", 0, step + 1) for step in range(0 if settings.every else settings.alone)]
    stages += [Stage("turn")] if stages[-1].name == "adapt" and not settings.every else []
    for number, rounds in enumerate(settings.rounds):
        stages += [Stage("track")] if number else []
        stages += [Stage("adapt", number + 1, step + 1) for step in range(rounds)]
    stages += [Stage("track")] if stages[-1].name in ("adapt", "turn") else []
    stages += [Stage("pose")]
    return [*stages, Stage("smooth")] if settings.smooth else stages


def tracker_of(task: Task, body: Body) -> Tracker:
    """The tracker of a body that is being adapted, with the task's terms."""
    return make_tracker(body, terms=() if task.terms is None else terms_of(task.terms))
