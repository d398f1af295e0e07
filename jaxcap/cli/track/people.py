"""`jaxcap track --people`: the journal, the frames and the results of several people."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...body.pose import Motion, Pose
from ...errors import InputError
from ...observe.clouds import Cloud
from ...observe.planes import Plane
from ...tracking.advance import FirstSearch, Search
from ...tracking.judgement.region_samples import sample_regions
from ...tracking.people.person_frame import PersonFrame, absent_person
from ...tracking.people.track_people import track_people
from ...tracking.track import unseen_sentences, verdict_sentences
from ...tracking.track_frame import Tracker
from ..body_models import load_model_of, write_parameters
from ..console.console import say, warn
from .deviations import Deviations, find_deviations, good_frames
from .frame_records import POSE_AT, Results, unpack, unpack_results
from .person_shape import SHAPE_FRAMES
from .results import PARAMETERS, make_writable, person_folder, write_results

AUTO = "auto"


def read_count(people: str) -> int | None:
    """Read the value of --people: a number from 1, or None for `auto`. Raises `InputError`."""
    if people == AUTO:
        return None
    if not people.isdecimal() or int(people) < 1:
        raise InputError(f"--people is {people}; it must be a number of at least 1, or auto.")
    return int(people)


def people_template(trackers: Sequence[Tracker], num_cameras: int) -> tuple[PersonFrame, ...]:
    """Make a frame of all people, with the shapes and types of all frames of a run."""
    first, size = trackers[0], len(trackers)
    return (absent_person(first, sample_regions(first.body, first.regions), size, num_cameras),) * size


def follow_people(
    trackers: Sequence[Tracker],
    clouds: Iterable[Cloud],
    template: tuple[PersonFrame, ...],
    count: int | None,
    last: tuple[PersonFrame, ...] | None,
    *,
    search: FirstSearch,
    sigma: float,
    first: int,
    announce: Callable[[Search, str], None],
    planes: Sequence[Plane],
) -> Iterator[tuple[PersonFrame, ...]]:
    """Track all people after the `last` frame; people who have not been seen yet are those of the template.

    `count` is None if the number of people is to be found, who then have the same tracker.
    """
    start = last
    if last is not None and count is None:
        start = tuple(person for person in last if person.seen)
    frames = track_people(
        trackers[0] if is_same_for_all(trackers) else trackers,
        clouds,
        count,
        start,
        search=search,
        sigma=sigma,
        first=first,
        on_search=lambda person, search: announce(search, f" of person {person + 1} in"),
        planes=planes,
    )
    for people in frames:
        yield people + template[len(people) :]


def is_same_for_all(trackers: Sequence[Tracker]) -> bool:
    """Test if all people have the same tracker."""
    return all(one is trackers[0] for one in trackers)


def write_people(
    folder: Path,
    trackers: Sequence[Tracker],
    template: tuple[PersonFrame, ...],
    rows: Float[np.ndarray, "N R"],
    rate: float,
    names: Sequence[str],
    spec: str,
    vertices: int | None,
    own_cloud: Callable[[int, int], Cloud] | None = None,
) -> None:
    """Write the results of each person into the folder `person_1` and so on, and print what was found.

    **Arguments:** `spec` names the body, which was reduced to about `vertices` vertices if given; `own_cloud`, the points of a person
    in a frame (`divide_clouds`), with which standard deviations are written too.

    **Raises:** `InputError` if nobody was found.
    """
    width = sum(np.size(leaf) for leaf in jax.tree.leaves(template[0]))
    found = 0
    for number, person in enumerate(template):
        own = np.concatenate(
            [rows[:, :POSE_AT], rows[:, POSE_AT + number * width : POSE_AT + (number + 1) * width]], axis=1
        )
        results = person_results(person, own)
        if results is None:
            continue
        found += 1
        where = person_folder(folder, number)
        make_writable(where)
        body = trackers[number].body
        write_results(where, body.skeleton, results, rate, names)
        known = None
        if own_cloud is not None:
            known = person_deviations(
                trackers[number], spec, vertices, results, partial(own_cloud, number), number
            )
        write_parameters(where / PARAMETERS, spec, body, Motion(results.poses, rate), vertices, known)
        for sentence in (*verdict_sentences(results.verdicts), *unseen_sentences(results.unseen)):
            warn(f"person {number + 1}: {sentence}")
        for sentence in exchange_sentences(number, person, own):
            warn(sentence)
    if not found:
        raise InputError(
            f"{folder}: nobody was found in the {len(rows)} frames. Check the unit, the up axis and the body, and remove "
            "floors and walls from the clouds."
        )
    say(
        f"{found} {'person was' if found == 1 else 'people were'} found; motion.bvh, motion.npz, statistics.csv and "
        f"statistics.json of each are in {person_folder(folder, 0)}{'' if found == 1 else ' and so on'}"
    )


def person_deviations(
    tracker: Tracker,
    spec: str,
    vertices: int | None,
    results: Results,
    cloud: Callable[[int], Cloud],
    number: int,
) -> Deviations | None:
    """Compute the deviations of one person; None, with a warning, if no frame that determines the shape is good."""
    good = good_frames(results.verdicts)
    some = [frame for frame in good if frame < SHAPE_FRAMES]
    if not some:
        warn(
            f"person {number + 1}: none of the first {SHAPE_FRAMES} frames has the verdict 'good', so deviations are not known"
        )
        return None
    return find_deviations(tracker, load_model_of(spec, vertices), cloud, results.poses, good, some)


def person_results(template: PersonFrame, rows: Float[np.ndarray, "N R"]) -> Results | None:
    """Decode the results of one person; None if the person was never seen.

    Before the person comes in, the pose is the first one.
    """
    results = unpack_results(template.tracked, rows)
    people = {number: unpack(template, rows[number])[0] for number in flagged_rows(template, rows)}
    seen = np.array([people[number].seen if number in people else True for number in range(len(rows))])
    if not seen.any():
        return None
    first = int(np.argmax(seen))
    index = np.maximum(np.arange(len(rows)), first)
    verdicts, unseen = list(results.verdicts), list(results.unseen)
    for number, person in people.items():
        verdicts[number], unseen[number] = (person.verdict, person.reasons), person.unseen
    poses: Pose = jax.tree.map(lambda leaf: jnp.asarray(leaf)[index], results.poses)
    return results._replace(poses=poses, verdicts=verdicts, unseen=unseen)


def flagged_rows(template: PersonFrame, rows: Float[np.ndarray, "N R"]) -> list[int]:
    """List the rows in which a person is absent or may have been exchanged."""
    at = POSE_AT + sum(np.size(leaf) for leaf in jax.tree.leaves(template.tracked))
    present = rows[:, at + 1] > 0
    exchanged = np.any(rows[:, -len(template.exchanges) :] > 0, axis=1)
    return np.flatnonzero(~present | exchanged).tolist()


def exchange_sentences(number: int, template: PersonFrame, rows: Float[np.ndarray, "N R"]) -> list[str]:
    """Describe the possible exchanges of a person, with the frames; without full stops."""
    frames: dict[str, list[int]] = {}
    for row in flagged_rows(template, rows):
        for reason in unpack(template, rows[row])[0].exchange_reasons:
            frames.setdefault(reason.removeprefix("this person"), []).append(row)
    return [
        f"person {number + 1}{reason} at frame {', '.join(map(str, at))}, counted from 0"
        for reason, at in frames.items()
    ]
