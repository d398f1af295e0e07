"""The task, the state and the stages of an adaptation (Adaptation, 4.1.4)."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from jaxtyping import Array, Float

from ..body.body import Body
from ..body.body_model import BodyModel
from ..body.pose import Motion, Pose
from ..energy.data.cloud_extent import TOLERANCE
from ..energy.energy import AbstractEnergy, terms_of
from ..errors import InputError, user_message
from ..fit.correspondence.find_pairs import Matching
from ..fit.correspondence.nearest_assignment import IndexedScan, NearestOnSurface, make_scan
from ..geometry.camera import Camera
from ..limits.rotation_vector_boxes import PoseBoxes
from ..observe.clouds import Cloud
from ..tracking.judge_frame import TrackedFrame
from ..tracking.track_frame import Tracker, make_tracker, replace_body
from ..value_checks import check_at_least, check_positive
from .objective import PoseTerms, Terms
from .shape.shape_prior import ShapePrior

#: number of adaptations of a body during tracking
NUM_ADAPTATIONS = 10

#: Points of a scan are matched with triangles of the body: planes at vertices lie outside of the triangles of a convex body.
#: Vertices are matched with points, too: without these pairs, parts of the body that have no points leave the scan.
#: Vertices beyond an end of the scan are matched with this end: without these pairs, soles and finger tips are outside of it.
TO_TRIANGLES = Matching(assignment=NearestOnSurface(exact=False), end_tolerance=TOLERANCE)


class AdaptSettings(NamedTuple):
    """The settings of an adaptation.

    Weights are relative to the mean squared distance of a pair, metres squared, but
    `shape_weights` to the sum of these squares, so that more scans count more.
    """

    #: number of frames that the body is adapted to, spread over the motion
    num_frames: int = 40
    #: rounds of joints with their skin, or of shape coefficients if a shape space is known, before vertices
    #: are adapted
    proportion_rounds: int = 6
    #: rounds of vertices and joints in each pass
    rounds: tuple[int, ...] = (5, 3)
    #: weights of the Laplacian term in the first and the last round; the last round of the last pass chooses one of four between them
    #: by cross-validation, larger ones for noisier scans
    shape_weights: tuple[float, float] = (100.0, 3.0)
    #: weight of the pose prior; None uses a tenth of the weight that balances it with the data in the first
    #: frames (eq. 4.15)
    pose_weight: float | None = None
    #: weight of second differences; None uses a tenth of the weight that balances them with the data (eq.
    #: 4.16), 0 disables them
    temporal_weight: float | None = None
    #: adapt during tracking, after every `every` frames (multi-time adaptation); 0 tracks all
    #: frames first and then adapts to the most informative ones (guided adaptation)
    every: int = 0
    #: standard deviation of a joint from its position regressed from the surface, metres
    joint_deviation: float = 0.005
    #: standard deviation of a pair's distance, metres
    pair_deviation: float = 0.003
    matching: Matching = TO_TRIANGLES
    #: solve for vertices, joints and poses in one step of each round, not one after the other
    simultaneous: bool = False
    #: the scans are not ordered in time: no term couples them, and the search for a pose starts from the most
    #: similar scans; None lets `make_adapt_task` determine it from the scans
    unordered: bool | None = None

    @property
    def smooth(self) -> bool:
        """True if the motion is smoothed in time."""
        return self.temporal_weight != 0.0 and not self.unordered


def check_settings(settings: AdaptSettings) -> None:
    """Check that settings are in their ranges.

    **Raises:** `InputError` for the first setting that is not.
    """
    where = "AdaptSettings"
    check_at_least(where, 1, num_frames=settings.num_frames)
    check_at_least(
        where, 0, proportion_rounds=settings.proportion_rounds, rounds=settings.rounds, every=settings.every
    )
    check_at_least(
        where,
        0,
        shape_weights=settings.shape_weights,
        pose_weight=settings.pose_weight,
        temporal_weight=settings.temporal_weight,
    )
    check_positive(
        where, "metres", joint_deviation=settings.joint_deviation, pair_deviation=settings.pair_deviation
    )


class OtherPerson(NamedTuple):
    """Scans of one person, who differs from the person in most of the scans (`compare_people`)."""

    frames: tuple[int, ...]
    #: parts of the body with the distance of their surface from that of most scans, metres, outwards; the clearest first
    differences: tuple[tuple[str, float], ...]
    #: number of all scans that were compared
    compared: int


class AdaptState(NamedTuple):
    """The state of an adaptation; an adaptation resumed from it gives bitwise the same result."""

    #: number of finished stages
    done: int
    body: Body
    #: the actor's size relative to the template's
    size: float
    #: poses of all frames
    motion: Motion
    #: frames that the body explains worse than is normal for the sequence, or that have no scan
    lost: tuple[int, ...] = ()
    #: frames that the body is currently adapted to, in poses that were adapted with it; empty if they are to be chosen
    chosen: tuple[int, ...] = ()
    #: the name of each stage, and the root mean square distance of a pair after it, millimetres
    history: tuple[tuple[str, float], ...] = ()
    #: the actor's shape coefficients relative to the template; empty before they are estimated
    coefficients: tuple[float, ...] = ()
    #: weight of the pose prior
    pose_weight: float = 0.0
    #: the value of each term after each stage, in the order of `history`
    terms: tuple[Terms, ...] = ()
    #: weight of second differences, once it is balanced
    temporal_weight: float = 0.0
    #: finished frames of the next stage
    within: int = 0
    #: the last of these frames, if the stage is one of tracking
    tracked: TrackedFrame | None = None
    #: the reason for each of the `lost` frames
    reasons: tuple[str, ...] = ()
    #: scans that seem to show other people than most scans do; only after the last stage
    others: tuple[OtherPerson, ...] = ()


class AdaptTask(NamedTuple):
    """The constant inputs of an adaptation."""

    template: Body
    #: the cloud of a frame
    cloud: Callable[[int], Cloud]
    num_frames: int
    rate: float
    #: a pose near that of the first frame; None searches for one
    start: Pose | None
    prior: AbstractEnergy
    #: pairs of joints, left and right, with bones of equal length
    left_right_pairs: tuple[tuple[int, int], ...]
    settings: AdaptSettings
    #: the shape space of people with the template's triangles
    shape_space: BodyModel | None = None
    #: the calibrated, static sensors: vertices that none of them sees are in no pair; empty disables this
    #: test
    cameras: tuple[Camera, ...] = ()
    #: frames without a usable scan, for which `cloud` is not called; at least one other frame has a scan
    missing: tuple[int, ...] = ()
    #: the hard limits of joint rotations
    boxes: PoseBoxes | None = None
    #: the shape prior of training meshes; None uses that of the template, or of the person of the shape space
    shape_prior: ShapePrior | None = None
    #: further energies of every frame, in units of a log-likelihood
    terms: AbstractEnergy | None = None
    #: the scan of a frame with its triangles, if scans are meshes; None builds scans from the points of
    #: clouds
    mesh: Callable[[int], IndexedScan] | None = None

    @property
    def scanned(self) -> list[int]:
        """The frames that have a scan."""
        return sorted(set(range(self.num_frames)) - set(self.missing))

    def pose_terms(self, weight: float | Float[Array, ""]) -> PoseTerms:
        """Return the terms of a pose, with the prior at a weight."""
        return PoseTerms(self.prior, weight, self.boxes, self.terms)

    def frames_of(self, stage: "Stage") -> list[int]:
        """List the frames with a scan that a stage processes."""
        return [n for n in self.scanned if stage.frames is None or n < stage.frames] or self.scanned[:1]

    def scan(self, frame: int) -> IndexedScan:
        """Return the scan of a frame, in which pairs are found.

        **Raises:** `InputError` if the cloud of the frame has no points.
        """
        if self.mesh is not None:
            return self.mesh(frame)
        cloud = self.cloud(frame)
        try:
            return make_scan(cloud)
        except ValueError as error:
            raise InputError(
                f"frame {frame}: {user_message(error)} Add it to the `missing` frames."
            ) from None

    def subset(self, frames: Sequence[int]) -> "AdaptTask":
        """Restrict the task to some of the frames, numbered from 0."""
        mesh = self.mesh
        return self._replace(
            cloud=lambda number: self.cloud(frames[number]),
            mesh=None if mesh is None else lambda number: mesh(frames[number]),
            num_frames=len(frames),
            missing=tuple(number for number, frame in enumerate(frames) if frame in self.missing),
        )


class Stage(NamedTuple):
    """One stage of an adaptation.

    Passes (`pass_number`) and rounds count from 1. Pass 0 comes before any vertex is adapted.
    """

    name: str
    pass_number: int = 0
    round: int = 0
    #: number of leading frames that the stage is limited to; None is all
    frames: int | None = None

    def __str__(self) -> str:
        if self.frames is not None:
            return f"{self.name} to frame {self.frames}"
        if self.name != "adapt":
            return self.name
        return (
            f"pass {self.pass_number}, round {self.round}"
            if self.pass_number
            else f"proportions, round {self.round}"
        )


def plan_stages(settings: AdaptSettings) -> list[Stage]:
    """List the stages of an adaptation in order."""
    stages = [Stage("size")]
    if settings.every:
        for time in range(1, NUM_ADAPTATIONS + 1):
            stages.append(Stage("track", frames=time * settings.every))
            alone = time <= settings.proportion_rounds // 2
            stages.append(Stage("adapt", 0 if alone else 1, time if alone else 1, time * settings.every))
    stages.append(Stage("track"))
    stages += [
        Stage("adapt", 0, step + 1) for step in range(0 if settings.every else settings.proportion_rounds)
    ]
    stages += [Stage("turn")] if stages[-1].name == "adapt" and not settings.every else []
    for number, rounds in enumerate(settings.rounds):
        stages += [Stage("track")] if number else []
        stages += [Stage("adapt", number + 1, step + 1) for step in range(rounds)]
    stages += [Stage("track")] if stages[-1].name in ("adapt", "turn") else []
    stages += [Stage("pose")]
    return [*stages, Stage("smooth")] if settings.smooth else stages


def make_task_tracker(task: AdaptTask, body: Body) -> Tracker:
    """Make a tracker of the current body with the task's terms, and with the template's regions of verdicts."""
    tracker = make_tracker(task.template, terms=() if task.terms is None else terms_of(task.terms))
    return replace_body(tracker, body)
