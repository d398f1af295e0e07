"""Joints of the human whose positions the surface hardly shows: close ones, and those with hardly any surface of their own."""

import functools

import numpy as np

from ...body.skeleton import Skeleton, has_same_joints
from ...geometry.mesh import vertex_areas
from ...rigging.template import load_template

#: the length of a bone between close joints, as a share of the extent of the human's joints: 7 cm for a person
MAX_SHARE = 0.045
#: ends of the names of elbows and knees
HINGES = ("ForeArm", "tLeg")
#: joints with a smaller share of the surface of the human move hardly any of it but for what hangs on the next joint
MIN_AREA_SHARE = 0.01


def close_joints(skeleton: Skeleton) -> tuple[tuple[int, int], ...]:
    """Return the pairs of a joint's parent and the joint, both moving, that are close in the human at rest.

    These are neck and head, and the wrist and the base of the fingers if both move. Other skeletons than the human's have none.
    """
    if not _is_human(skeleton):
        return ()
    return tuple(
        (parent, joint)
        for joint, parent in _short_bones()
        if skeleton.kinds[joint] != "fixed" and skeleton.kinds[parent] != "fixed"
    )


def hidden_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """Return the joints whose positions no motion shows.

    Three ball joints in one place, as those of neck and head, explain any motion of the bone beyond them, wherever they are. Of a
    shoulder blade, only the position of the next joint is seen, which is unknown as well.
    """
    close = close_joints(skeleton)
    hidden = {
        joint
        for first, second in close
        for third, fourth in close
        if second == third
        for joint in (first, second, fourth)
    }
    if _is_human(skeleton):
        hidden |= _bare_joints() - {joint for pair in close for joint in pair}
    return tuple(sorted(hidden))


def hinges(skeleton: Skeleton) -> tuple[int, ...]:
    """Return the elbows and knees of the human, whose positions along their axes no motion shows.

    A forearm twists, so that its motion seems to show this position, too, but it does so about the wrist.
    """
    if not _is_human(skeleton):
        return ()
    return tuple(joint for joint, name in enumerate(skeleton.names) if name.endswith(HINGES))


def _is_human(skeleton: Skeleton) -> bool:
    return has_same_joints(skeleton, load_template().body.skeleton)


@functools.cache
def _bare_joints() -> frozenset[int]:
    """Return the ball joints of the template with hardly any surface of their own that lead to other ball joints."""
    body = load_template().body
    leading = {
        parent
        for parent, kind in zip(body.skeleton.parents, body.skeleton.kinds, strict=True)
        if kind == "ball"
    }
    areas = vertex_areas(np.asarray(body.vertices, float), np.asarray(body.faces))
    shares = (
        np.bincount(np.asarray(body.skin.dominant_bones()), areas, body.skeleton.num_joints) / areas.sum()
    )
    return frozenset(
        joint
        for joint, (share, kind) in enumerate(zip(shares, body.skeleton.kinds, strict=True))
        if kind == "ball"
        and share < MIN_AREA_SHARE
        and joint in leading
        and body.skeleton.parents[joint] >= 0
    )


@functools.cache
def _short_bones() -> tuple[tuple[int, int], ...]:
    """Return the joints of the template with a short bone to their parents, and the parents."""
    skeleton = load_template().body.skeleton
    centres, parents = np.asarray(skeleton.centres, float), np.array(skeleton.parents)
    longest = MAX_SHARE * np.ptp(centres, axis=0).max()
    below = np.flatnonzero(parents >= 0)
    lengths = np.linalg.norm(centres[below] - centres[parents[below]], axis=1)
    return tuple((int(joint), int(parents[joint])) for joint in below[lengths < longest])
