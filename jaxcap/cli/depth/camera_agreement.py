"""Doubts about cameras whose depth images do not agree on where the person is."""

from collections import Counter

from ...depth.agreement import compare_views
from ...depth.background import MAX_FRAMES
from ...errors import InputError, join_names
from ...geometry.sampling import even_indices
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ..console.heartbeat import set_activity

#: number of frames that are compared, and of points that a camera has to see in them
NUM_COMPARED, MIN_SEEN = 5, 200
#: share of the points in empty space that noise and edges do not explain: it is at most 3 % for correct simulated cameras
MIN_EMPTY_SHARE = 0.08


def describe_disagreement(clouds: LazyFrames[Cloud], num_cameras: int) -> list[str]:
    """Describe which cameras see the person in space that another one saw empty, in some spread frames that show the person.

    The list has one sentence without a full stop, with the largest share of such points, or none. Frames that cannot be read
    are left out: tracking reports them.
    """
    if num_cameras < 2:
        return []
    set_activity("comparing the cameras")
    shares = {pair: share for pair, share in _empty_shares(clouds).items() if share >= MIN_EMPTY_SHARE}
    if not shares:
        return []
    pairs = join_names([f"{one} and {other}" for one, other in sorted(shares)])
    return [
        f"cameras {pairs} disagree: up to {100 * max(shares.values()):.0f} % of the person's points of one are in space that "
        "the other saw empty; check their positions and directions (extrinsics), and that they took their images at one time"
    ]


def _empty_shares(clouds: LazyFrames[Cloud]) -> dict[tuple[int, int], float]:
    """Compute the share of points in empty space for each two cameras, the larger one of both directions."""
    seen, empty, count = Counter[tuple[int, int]](), Counter[tuple[int, int]](), 0
    for number in even_indices(len(clouds), MAX_FRAMES, nearest=True).tolist():
        try:
            found = compare_views(clouds[number].views)
        except InputError:
            continue
        for pair, one in found.items():
            seen[pair] += one.seen
            empty[pair] += one.empty
        count += bool(found)
        if count == NUM_COMPARED:
            break
    shares: dict[tuple[int, int], float] = {}
    for (one, other), number in seen.items():
        pair = min(one, other), max(one, other)
        if number >= MIN_SEEN:
            shares[pair] = max(shares.get(pair, 0.0), empty[one, other] / number)
    return shares
