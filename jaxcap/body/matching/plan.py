"""Compute the part of a retargeting that is constant over frames: the correspondence of joints and alignment
of rest poses.

Every bone of the target with a match has the world rotation of its source bone, after a constant rotation
that compensates for the two rest poses (T-pose and A-pose). Limbs are aligned bone by bone, so that they have
the same directions, and so that elbows and knees bend about the same axis. The trunk is aligned as a whole,
as its bones differ by anatomy and not by pose.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...geometry import rotation
from ...geometry.axes import nearest_signed_permutation
from ...geometry.procrustes import nearest_rotation
from ...geometry.sampling import even_indices
from ..pose import Motion, take_poses
from ..skeleton import Skeleton
from ..symmetry import left_right_pairs_by_name
from .hinges import hinge_axis, rest_hinge_axis, twist_between
from .joint_matches import JointMatches
from .match_joints import SIDES, match_joints
from .person_joints import far_end
from .upright_pose import joint_transforms

#: default vertical, if no legs determine it
UP = np.array([0.0, 1.0, 0.0])
#: number of frames for the estimation of hinges
MAX_FRAMES = 300
#: limbs whose rest poses agree within this are not rotated about their bones, radians
REST_TOLERANCE = 1e-3


class RetargetPlan(NamedTuple):
    """The constant part of a retargeting; J is the number of joints of the target, S of the source."""

    matches: JointMatches
    #: (J, 2) the two source joints between which each one is interpolated, -1 for none, and (J,) the share of
    #: the second
    sources: np.ndarray
    shares: np.ndarray
    #: (S, 4) world rotations of the source in its upright pose
    reference: np.ndarray
    #: (J, 4) rotation from the target's rest to the source's upright pose, bone by bone
    alignment: np.ndarray
    #: joints whose mean position is transferred: indices into source and target
    anchors: tuple[np.ndarray, np.ndarray]
    #: size ratio of target to source
    ratio: float
    #: (3,) the vertical of the source's world
    up: np.ndarray


@checked
def plan_retarget(
    source: Skeleton,
    target: Skeleton,
    names: Mapping[str, str | None] | None = None,
    motion: Motion | None = None,
) -> RetargetPlan:
    """Match two skeletons and align their rest poses.

    **Arguments:** `names` as in `match_joints`. `motion` of the source determines the hinge axes of its
    elbows and knees, and its upright pose if the rest pose is not one.

    **Raises:** as `match_joints` does.
    """
    matches = match_joints(source, target, names, motion=motion)
    here, there = matches.references
    centres = np.asarray(target.centres, float)
    followed = matches.followed
    sources, shares = np.full((target.num_joints, 2), -1), np.zeros(target.num_joints)
    for joint, (a, b, share) in followed.items():
        sources[joint], shares[joint] = (a, b), share
    upright = _trunk_alignment(matches, centres)
    alignment = _align_bones(matches, centres, upright, _hinge_axes(matches, motion))
    follows = _next_matched_joints(target, source, matches.pairs)
    legs = [
        leg for side in SIDES if (leg := there.person.limb(side, "leg")) and set(leg) <= set(matches.pairs)
    ]
    bones = [pair for leg in legs for pair in pairwise(leg)] or list(follows.items())
    lengths = [
        sum(np.linalg.norm(positions[own(b)] - positions[own(a)]) for a, b in bones)
        for positions, own in ((centres, int), (here.positions, matches.pairs.__getitem__))
    ]
    anchors = np.array([leg[0] for leg in legs] or [min(matches.pairs)])
    ratio = float(lengths[0] / lengths[1]) if lengths[1] > 0 else 1.0
    up = here.up if here.up is not None and legs else UP
    return RetargetPlan(
        matches,
        sources,
        shares,
        here.rotations,
        alignment,
        (np.array([matches.pairs[joint] for joint in anchors]), anchors),
        ratio,
        up,
    )


def _align_bones(matches: JointMatches, centres: np.ndarray, upright: np.ndarray, hinges) -> np.ndarray:
    """Compute the rotation of each target bone from its rest to the source's upright pose, (J, 4)."""
    source, target = matches.source, matches.target
    person, pairs = matches.references[1].person, matches.pairs
    positions = matches.references[0].positions
    limbs = _limb_bones(matches)
    follows, descent = _next_matched_joints(target, source, pairs), source.descendants
    girdles = {joint for (_, part), joint in person.parts.items() if part == "clavicle"}
    ends = {joint for (_, part), joint in person.parts.items() if part in ("hand", "foot")}
    sided = {joint for pair in left_right_pairs_by_name(target.names) for joint in pair} | set(
        person.parts.values()
    )
    alignment = np.tile(np.asarray(rotation.from_matrix(jnp.asarray(upright))), (target.num_joints, 1))
    for joint in sorted(sided):
        parent = target.parents[joint]
        if parent >= 0:
            alignment[joint] = alignment[parent]
        if joint in limbs:
            child, own = limbs[joint]
        else:
            child = follows.get(joint)
            own = pairs.get(child) if child is not None else None
        # a hand or foot without an end in both skeletons continues the bone above
        blunt = joint in ends and joint not in limbs
        if joint not in pairs or child is None or own is None or joint in girdles or blunt:
            continue
        if not descent[pairs[joint], own]:
            continue
        bone = centres[child] - centres[joint]
        goal = positions[own] - positions[pairs[joint]]
        lengths = np.linalg.norm(bone), np.linalg.norm(goal)
        if min(lengths) < 1e-6:
            continue
        # start from the parent's alignment, so that no twist is introduced
        turned = jnp.asarray(alignment[joint])
        carried = rotation.rotate(turned, jnp.asarray(bone / lengths[0]))
        turned = rotation.multiply(rotation.shortest_arc(carried, jnp.asarray(goal / lengths[1])), turned)
        if joint in hinges:
            bend, normal = hinges[joint]
            twist = twist_between(np.asarray(rotation.rotate(turned, jnp.asarray(bend))), normal, goal)
            about = rotation.about_axis(jnp.asarray(goal / lengths[1]), jnp.asarray(twist))
            turned = rotation.multiply(about, turned)
        alignment[joint] = turned
    return alignment


def _limb_bones(matches: JointMatches) -> dict[int, tuple[int, int]]:
    """Find the far ends of the bones of matched limb joints, in target and source."""
    here, there = (upright.person for upright in matches.references)
    found: dict[int, tuple[int, int]] = {}
    for side in SIDES:
        for kind in ("leg", "arm"):
            limb = [joint for joint in there.limb(side, kind) if joint in matches.pairs]
            found |= {a: (b, matches.pairs[b]) for a, b in pairwise(limb)}
            last = there.parts.get((side, "foot" if kind == "leg" else "hand"))
            if last is None or last not in matches.pairs:
                continue
            end = far_end(matches.target, there, side, kind, last)
            own = far_end(matches.source, here, side, kind, matches.pairs[last])
            if end is not None and own is not None:
                found[last] = end, own
    return found


def _hinge_axes(matches: JointMatches, motion: Motion | None) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Find the hinge axes of limbs by their first joints: the target's at rest, and the source's in the
    upright pose."""
    upright, source = matches.references[0], matches.source
    centres, found = np.asarray(matches.target.centres, float), {}
    if motion is None or len(motion) == 0:
        positions, turns = upright.positions[None], upright.rotations[None]
    else:
        frames = even_indices(len(motion), MAX_FRAMES)
        positions, turns = joint_transforms(source, take_poses(motion.poses, frames))
    for side in SIDES:
        for kind in ("leg", "arm"):
            limb = matches.references[1].person.limb(side, kind)
            if not limb or not set(limb) <= set(matches.pairs):
                continue
            own = rest_hinge_axis(*centres[list(limb)])
            here = [matches.pairs[joint] for joint in limb]
            if own is None or _has_equal_rest(centres[list(limb)], upright.positions[here], matches):
                continue
            bone = matches.followed[limb[0]][0]
            normal = hinge_axis(
                source,
                (here[0], here[1], here[2]),
                positions,
                _matrices(turns[:, bone]),
                upright.positions,
                _matrices(upright.rotations[bone]),
            )
            if normal is None:
                continue
            if source.kinds[here[1]] == "revolute":
                # the sign of a joint axis is arbitrary: the limb's own bend determines it, or else the nearer
                # direction
                normal = normal * (
                    _bend_sign(positions, turns[:, bone], here, normal, upright.rotations[bone]) or 1.0
                )
            found[limb[0]] = own, normal
    return found


def _bend_sign(positions, rotations, limb, normal: np.ndarray, reference: np.ndarray) -> float:
    """Determine the sign of a limb's bend about an axis; zero if it does not bend."""
    upper, lower = (positions[:, limb[i + 1]] - positions[:, limb[i]] for i in (0, 1))
    own = np.einsum("fba,fb->fa", _matrices(rotations), np.cross(upper, lower)).sum(axis=0)
    return float(np.sign(_matrices(reference) @ own @ normal))


def _has_equal_rest(here: np.ndarray, there: np.ndarray, matches: JointMatches) -> bool:
    """Check whether the bones of a limb have the same directions in both rest poses."""
    if matches.references[0].frame is not None:
        return False
    a, b = (
        np.diff(limb, axis=0) / np.linalg.norm(np.diff(limb, axis=0), axis=1)[:, None]
        for limb in (here, there)
    )
    return bool(np.linalg.norm(a - b, axis=1).max() < REST_TOLERANCE)


def _matrices(quaternions: np.ndarray) -> np.ndarray:
    return Rotation.from_quat(quaternions[..., [1, 2, 3, 0]]).as_matrix()


def _next_matched_joints(target: Skeleton, source: Skeleton, pairs: Mapping[int, int]) -> dict[int, int]:
    """Find the next matched joint along the longest chain of matched joints below each one."""
    chain = dict.fromkeys(pairs, 0)
    follows: dict[int, int] = {}
    for joint in sorted(pairs, reverse=True):
        above = target.parents[joint]
        while above >= 0 and above not in pairs:
            above = target.parents[above]
        if above >= 0 and chain[joint] + 1 >= chain[above]:
            chain[above], follows[above] = chain[joint] + 1, joint
    return follows


def _trunk_alignment(matches: JointMatches, centres: np.ndarray) -> np.ndarray:
    """Compute the rotation from the target's rest to the source's upright pose, independently of the arms,
    (3, 3).

    It is computed from left, up and front of both. If these are unknown, it is the best fit of the joints
    (Kabsch), snapped to the nearest rotation of the coordinate axes, because a person at rest stands along
    them. If none is near, it is the fit itself.
    """
    here, there = matches.references
    if here.axes is not None and there.axes is not None:
        return here.axes @ there.axes.T
    joints = sorted(matches.pairs)
    target, source = centres[joints], here.positions[[matches.pairs[joint] for joint in joints]]
    fit = nearest_rotation((source - source.mean(0)).T @ (target - target.mean(0)))
    snapped = nearest_signed_permutation(fit)
    near = np.trace(snapped.T @ fit) > 1 + 2 * np.cos(np.radians(30.0)) and np.linalg.det(snapped) > 0
    return snapped if near else fit
