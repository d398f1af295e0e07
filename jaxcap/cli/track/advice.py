"""Advice after a tracking run: another size of the body, or another vertical, may explain the data."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...body.pose import Pose
from ...energy.priors.human_prior import human_prior
from ...geometry import rotation
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ...observe.floors_and_walls import remove_planes
from ...observe.planes import Plane
from ...tracking.judge_frame import MUCH_LIKELIER
from ...tracking.search.initialise import PERSON_SIZES, initialise, joint_terms, search_size
from ...tracking.track_frame import Tracker
from ..console.console import say, warn
from ..console.heartbeat import set_activity
from ..sources import UPS, Up, up_rotation
from .person_shape import people_until_unreadable
from .results import Results

#: largest angle of an upright person from the vertical, degrees, and least share of such frames without advice
MAX_LEAN, MIN_UPRIGHT_SHARE = 60.0, 0.5
#: share of lost frames from which on a good first frame may be wrong
MANY_LOST = 0.5


def advise(
    tracker: Tracker,
    clouds: LazyFrames[Cloud],
    planes: Sequence[Plane],
    results: Results,
    up: Up,
    *,
    fits_shape: bool,
) -> None:
    """Warn of another vertical if the person lies, and of another vertical or size if one explains the first frame better.

    The first frame that shows a person is searched if it is not `good`, or if most frames are lost. `fits_shape`, the size was fitted to the person.
    """
    if warn_of_vertical(results, up):
        return
    shown = first_person(clouds)
    lost = np.mean([verdict == "lost" for verdict, _ in results.verdicts])
    if shown is None or (results.verdicts[shown[0]][0] == "good" and lost < MANY_LOST):
        return
    say(
        "comparing other verticals and sizes of the person in the first frame, which may take a minute or two"
    )
    # a floor is one of the given vertical
    free = eqx.tree_at(lambda t: t.terms, tracker, joint_terms(tracker))
    cloud = remove_planes(shown[1], planes)
    if warn_of_other_vertical(free, cloud, up) or (not fits_shape and warn_of_size(free, cloud)):
        return
    if lost >= MANY_LOST:
        cause = (
            "--depth-scale, --cameras and, with --masks, what is found to be the person"
            if cloud.views
            else "the unit and the body"
        )
        warn(
            f"most frames are lost, and neither another vertical nor another size explains the first one; check {cause}"
        )


def first_person(clouds: LazyFrames[Cloud]) -> tuple[int, Cloud] | None:
    """Return the first cloud that shows a person, with its number; None if an earlier one cannot be read."""
    return next(people_until_unreadable(clouds), None)


def warn_of_size(tracker: Tracker, cloud: Cloud) -> bool:
    """Return whether a person of another size explains a cloud better, and warn.

    Only for bodies with the joints of a person, whose shape can be fitted. A part of a person fits several sizes, so there only
    the largest and the smallest count.
    """
    if human_prior(tracker.body.skeleton) is None:
        return False
    set_activity("comparing sizes of the body")
    size = search_size(tracker, cloud)
    expected = (
        (1.0,) if tracker.pose_prior is None else set(PERSON_SIZES) - {max(PERSON_SIZES), min(PERSON_SIZES)}
    )
    if np.isclose(size, list(expected)).any():
        return False
    unit = "--depth-scale" if cloud.views else "--unit"
    warn(
        f"the first frame looks like a person of about {size:g} times the size of the body, and poses of a body of another "
        f"size are wrong; --fit-shape fits a human body to the person; otherwise check {unit}, or give a body of this size"
    )
    return True


def warn_of_vertical(results: Results, up: Up) -> bool:
    """Return whether the vertical may be another one, and warn: if the person lies or is upside down in most of the frames that are not lost."""
    kept = np.array([verdict != "lost" for verdict, _ in results.verdicts], bool)
    axes = trunk_axis(results.poses)[kept]
    upright = axes[:, 1] > np.cos(np.radians(MAX_LEAN))
    if 2 * len(axes) < len(kept) or np.mean(upright) >= MIN_UPRIGHT_SHARE:
        # where most frames are lost, something else is wrong
        return False
    name = axis_name(np.median(axes[~upright], axis=0), up)
    warn(
        f"in {np.mean(~upright):.0%} of the frames that are not lost the trunk points along {name} of the data, so the person lies or is upside down; "
        f"if the person stands, give --up={name}"
    )
    return True


def warn_of_other_vertical(tracker: Tracker, cloud: Cloud, up: Up) -> bool:
    """Return whether a person is much likelier in a cloud with another vertical, and warn."""
    set_activity("comparing verticals")
    found = {
        name: initialise(tracker, rotate_cloud(cloud, up_rotation(name) @ up_rotation(up).T)) for name in UPS
    }
    best = max(UPS, key=lambda name: float(found[name][1]))
    if float(found[best][1]) < float(found[up][1]) + MUCH_LIKELIER:
        return False
    # a search may turn a person over, so the trunk of the likeliest pose is the vertical, whatever it was searched with
    name = axis_name(trunk_axis(found[best][0]), best)
    if name == up:
        return False
    warn(
        f"a person is much likelier in the first frame if {name} is up; if the person stands, give --up={name}"
    )
    return True


def rotate_cloud(cloud: Cloud, turn: Float[np.ndarray, "3 3"]) -> Cloud:
    """Rotate a cloud and the cameras of its views about the origin."""
    back = jnp.asarray(turn, cloud.points.dtype).T
    views = tuple(
        eqx.tree_at(lambda v: v.camera.rotation, view, view.camera.rotation @ back) for view in cloud.views
    )
    return Cloud(cloud.points @ back, cloud.normals @ back, cloud.weights, views)


def trunk_axis(pose: Pose) -> Float[np.ndarray, "*frames 3"]:
    """Compute the direction in which a pose rotates the vertical of the root."""
    return np.asarray(rotation.to_matrix(pose.rotations[..., 0, :]), float)[..., :, 1]


def axis_name(direction: Float[np.ndarray, "3"], up: Up) -> str:
    """Name the axis of data with the vertical `up` that is nearest to a direction in a world with y up."""
    along = direction @ up_rotation(up)
    axis = int(np.argmax(np.abs(along)))
    return f"{'-' if along[axis] < 0 else ''}{'xyz'[axis]}"
