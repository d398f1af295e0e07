"""One person in one frame of a sequence with several people."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.pose import Pose, rest_pose
from ..expectation_maximisation.em_step import FrameStatistics
from ..judge_frame import SearchHistory, TrackedFrame
from ..judgement.baseline import initial_baseline
from ..judgement.region_samples import RegionSamples
from ..judgement.verdict import Judgement
from ..track_frame import Tracker, start_state

#: least number of points of a person who is present: this many, and this share of the usual number
MIN_POINTS, MIN_POINTS_SHARE = 40, 0.05
#: share of the usual number of points from which a person is seen well
SEEN_WELL_SHARE = 0.4
#: decrease of the usual number of points in a frame, if the person has fewer
USUAL_DECAY = 0.99
#: values of `PersonFrame.contacts`, and of `PersonFrame.exchanges`
APART, NEAR, UNSURE = 0.0, 1.0, 2.0
NO_EXCHANGE, UNDECIDED, CORRECTED = 0.0, 1.0, 2.0


class PersonFrame(eqx.Module):
    """One person in one frame; those of all people are sufficient to continue a run."""

    #: as of a single body; the last one of a person who is absent
    tracked: TrackedFrame
    #: the person has been in the scene so far
    seen: bool
    #: the person has points in this frame
    present: bool
    #: weight of the person's points, and its usual value
    num_points: float
    usual_points: float
    #: for each person: `APART`, `NEAR`, or `UNSURE` if one of the two was not seen well since they came near
    contacts: Float[Array, "K"]
    #: for each person, where a contact ends in this frame: `NO_EXCHANGE`, `UNDECIDED` if the two may have been exchanged,
    #: or `CORRECTED` if they had been exchanged and were exchanged back
    exchanges: Float[Array, "K"]

    @property
    def pose(self) -> Pose:
        """The pose, of an absent person the last one."""
        return self.tracked.pose

    @property
    def statistics(self) -> FrameStatistics:
        """Statistics of the fit, of an absent person the last ones."""
        return self.tracked.statistics

    @property
    def lost(self) -> bool:
        """The pose is unreliable, also as the person is absent."""
        return self.tracked.lost or not self.present

    @property
    def verdict(self) -> str:
        """`good`, `doubtful` or `lost`; an absent person is lost."""
        if self.lost:
            return "lost"
        return "doubtful" if self.exchange_reasons else self.tracked.verdict

    @property
    def reasons(self) -> tuple[str, ...]:
        """The faults in words, as those of a `TrackedFrame`; absence and possible exchanges are named too."""
        if not self.seen:
            return ("this person has not been in the scene yet",)
        if not self.present:
            return ("this person is not in the scene, or hidden",)
        return (*self.exchange_reasons, *self.tracked.reasons)

    @property
    def unseen(self) -> tuple[str, ...]:
        """Parts without points, by their joints."""
        return self.tracked.unseen if self.present else ()

    @property
    def exchange_reasons(self) -> tuple[str, ...]:
        """Sentences on exchanges with other people, who are counted from 1."""
        sentences = {
            UNDECIDED: "this person may have been exchanged with person {}",
            CORRECTED: "this person had been exchanged with person {}, which was corrected",
        }
        return tuple(
            sentences[code].format(other)
            for other, code in enumerate(np.asarray(self.exchanges, float).tolist(), 1)
            if code in sentences
        )

    @property
    def seen_well(self) -> bool:
        """The person is present, not lost, and has not much fewer points than usual."""
        return not self.lost and self.num_points >= SEEN_WELL_SHARE * self.usual_points


def has_points(person: PersonFrame, num_points: float) -> bool:
    """Decide from the number of points if a person is still present."""
    return num_points >= max(MIN_POINTS, MIN_POINTS_SHARE * person.usual_points)


def enter(person: PersonFrame, tracked: TrackedFrame, num_points: float) -> PersonFrame:
    """Make the frame of a person who has come into the scene."""
    usual = max(num_points, person.usual_points)
    none = jnp.zeros_like(person.contacts)
    return PersonFrame(tracked, True, True, num_points, usual, none, none)


def stay(person: PersonFrame, tracked: TrackedFrame, num_points: float) -> PersonFrame:
    """Make the next frame of a person who is present."""
    usual = max(num_points, USUAL_DECAY * person.usual_points)
    none = jnp.zeros_like(person.exchanges)
    return PersonFrame(tracked, True, True, num_points, usual, person.contacts, none)


def leave(person: PersonFrame, num_points: float) -> PersonFrame:
    """Make the next frame of a person without points."""
    none = jnp.zeros_like(person.exchanges)
    wait = person.tracked.searches.advance(False)
    tracked = eqx.tree_at(lambda f: f.searches, person.tracked, wait)
    return PersonFrame(tracked, person.seen, False, num_points, person.usual_points, person.contacts, none)


def absent_person(
    tracker: Tracker, surface: RegionSamples, num_people: int, num_cameras: int = 0
) -> PersonFrame:
    """Make the frame of a person who has not been seen, with the shapes and types of all frames."""
    tracked = frame_template(tracker, surface, rest_pose(tracker.body.skeleton), num_cameras)
    none = jnp.zeros(num_people, tracked.pose.rotations.dtype)
    return PersonFrame(tracked, False, False, 0.0, 0.0, none, none)


def frame_template(
    tracker: Tracker, surface: RegionSamples, pose: Pose, num_cameras: int = 0
) -> TrackedFrame:
    """Make a `TrackedFrame` with the shapes and types of all frames of a run, and no content.

    `num_cameras` is the number of known cameras of the clouds.
    """
    number = jnp.zeros((), pose.rotations.dtype)
    statistics = FrameStatistics(number, number, number, number, number)
    baseline = initial_baseline(surface, num_cameras)
    support = jnp.zeros(len(surface.joints), number.dtype)
    judgement = Judgement(
        baseline.level, number, number, support, surface.names, surface.joints, surface.part_parents
    )
    state = start_state(tracker, pose)
    return TrackedFrame(pose, statistics, False, judgement, False, state, pose, baseline, SearchHistory())


def present_people(people: Sequence[PersonFrame]) -> list[int]:
    """List the numbers of the people who are present."""
    return [number for number, person in enumerate(people) if person.present]
