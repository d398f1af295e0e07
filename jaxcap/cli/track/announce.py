"""Messages on the searches of a tracking run."""

from collections.abc import Callable

from ...tracking.advance import Search
from ...tracking.track_frame import Tracker
from ..console.console import warn


def make_announcer() -> Callable[..., None]:
    """Return a function that prints the frame of a pose search and its reason, before the search begins.

    Its second argument names the person, such as " of person 2 in".
    """
    compiled = False

    def announce(search: Search, whose: str = " of") -> None:
        nonlocal compiled
        why = f": {', '.join(search.reasons)}" if search.reasons else ""
        many = "1 search" if search.num_earlier == 1 else f"{search.num_earlier} searches"
        before = f"; {many} before it" if search.num_earlier else ""
        once = "" if compiled else "; the first search compiles its functions, which may take a minute"
        warn(f"searching for the pose{whose} frame {search.frame}{why}{before}{once}")
        compiled = True

    return announce


def warn_without_prior(tracker: Tracker) -> Tracker:
    """Warn if a tracker of partial views has no prior of people's poses; return it."""
    if tracker.pose_prior is None:
        warn(
            "the joints of the body have no names of a person's arms and legs, so no prior of people's poses determines the joints "
            "that the clouds do not show"
        )
    return tracker
