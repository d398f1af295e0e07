"""Markers on landmarks and joints of the embedded human at rest, with limbs of any length."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from ...body.people.human import human, shape_from_traits
from ...body.people.morph_targets import Traits
from ...body.skeleton import Skeleton
from ...geometry.attachment import Attachment, attached_positions
from ..marker_sets.joints_by_landmarks import joints_by_landmarks
from ..marker_sets.landmarks import joint_landmarks, landmark_attachment, mirror_name
from ..marker_sets.recognise import MarkerSet
from .population import LIMBS

#: least distance of a marker or joint at a side of the pelvis from its middle, metres
MIN_LATERAL = 0.02
#: resolution of the surface that markers are placed on
RESOLUTION = "low"


def placed_markers(markers: MarkerSet) -> Int[np.ndarray, "N"]:
    """List the markers with a known landmark that are no virtual points."""
    known = [name is not None for name in markers.names]
    return np.flatnonzero(np.array(known, bool) & ~markers.virtual)


def rest_positions(
    names: Sequence[str], heights: Float[np.ndarray, "M"], traits: Traits
) -> tuple[Float[np.ndarray, "M 3"], Float[np.ndarray, "J 3"]]:
    """Compute the rest positions of markers on landmarks, and of the joints, of a person, metres."""
    vertices, ends = shape_from_traits(traits, RESOLUTION)
    centres = joints_by_landmarks(vertices, ends[:, 0], RESOLUTION)
    every, hold = landmark_attachment(RESOLUTION)
    places, on_skin = np.zeros((len(names), 3)), [k for k, name in enumerate(names) if name in every]
    rows = [every.index(names[k]) for k in on_skin]
    own = Attachment(hold.corners[rows], hold.barycentric[rows], heights[on_skin])
    places[on_skin] = np.asarray(attached_positions(own, vertices), float)
    joints = human(resolution=RESOLUTION).skeleton.names
    for k, name in enumerate(names):
        if name in joint_landmarks():
            places[k] = centres[joints.index(joint_landmarks()[name].joint)]
    return places, centres


def limb_ends(skeleton: Skeleton) -> Int[np.ndarray, "4 2 2"]:
    """List the joints at the ends of each limb of `LIMBS`, of the left and of the right side."""
    return np.array(
        [
            [
                [skeleton.index(joint) for joint in ends],
                [skeleton.index(mirror_name(joint)) for joint in ends],
            ]
            for ends in LIMBS.values()
        ]
    )


def limb_lengths(skeleton: Skeleton, centres: Float[np.ndarray, "J 3"]) -> Float[np.ndarray, "4"]:
    """Compute the mean length of each limb on both sides, metres."""
    ends = centres[limb_ends(skeleton)]
    return np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).mean(1)


def stretch_fields(
    skeleton: Skeleton,
    centres: Float[np.ndarray, "J 3"],
    bones: Int[np.ndarray, "M"],
    places: Float[np.ndarray, "M 3"],
) -> tuple[Float[np.ndarray, "4 M 3"], Float[np.ndarray, "4 J 3"]]:
    """Compute how markers and joints move, metres, for each unit by which a limb is longer than its length, on both sides.

    Markers on the limb move along it, as far as they are along it; all below the limb moves with its end.
    """
    by_marker, by_joint = np.zeros((len(LIMBS), *places.shape)), np.zeros((len(LIMBS), *centres.shape))
    for limb, sides in enumerate(limb_ends(skeleton)):
        for start, end in sides:
            along = centres[end] - centres[start]
            below = np.asarray(skeleton.descendants[end])
            shares = (places - centres[start]) @ along / (along @ along)
            on_limb = np.where((bones == start)[:, None], np.clip(shares, 0.0, 1.0)[:, None] * along, 0.0)
            by_joint[limb] += np.where(below[:, None], along, 0.0)
            by_marker[limb] += np.where(below[bones][:, None], along, on_limb)
    return by_marker, by_joint


def bone_ends(
    skeleton: Skeleton,
    centres: Float[np.ndarray, "J 3"],
    bones: Int[np.ndarray, "M"],
    places: Float[np.ndarray, "M 3"],
) -> Int[np.ndarray, "M"]:
    """Find the joint nearest to each marker at rest, of the joints at both ends of its bone.

    A marker at a side of the pelvis has the hip of this side: the spine is nearer to those at the back, but shows no leg.
    """
    nearest = []
    for bone, place in zip(bones.tolist(), places, strict=True):
        ends = [bone, *_moving_children(skeleton, bone)]
        if skeleton.parents[bone] < 0:
            side, sides = (np.asarray(x)[..., 0] - centres[bone, 0] for x in (place, centres[ends]))
            same = sides * np.sign(side) > MIN_LATERAL
            if abs(side) > MIN_LATERAL and same.any():
                ends = [end for end, alike in zip(ends, same, strict=True) if alike]
        nearest.append(ends[int(np.argmin(np.linalg.norm(centres[ends] - place, axis=1)))])
    return np.array(nearest, int)


def _moving_children(skeleton: Skeleton, bone: int) -> list[int]:
    """List the joints at the ends of a bone; fixed joints are parts of it."""
    found = []
    for joint, parent in enumerate(skeleton.parents):
        if parent == bone:
            found += _moving_children(skeleton, joint) if skeleton.kinds[joint] == "fixed" else [joint]
    return found
