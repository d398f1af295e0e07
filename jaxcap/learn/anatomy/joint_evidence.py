"""The evidence of the meshes for each joint of a learned skeleton, and the lengths of its bones."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...arguments import checked
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ..skeleton.given_centres import GivenCentres
from ..skeleton.joint_centre_prior import MIN_ROTATION_GIVEN, given_pull, least_rotations, motion_information

#: share of the meshes in the position of a joint, across the direction that they determine least, above which they determine it
MIN_SHARE = 0.5
#: shorter bones, metres, connect joints in one place, such as those that carry the hips
MIN_LENGTH = 1e-3

#: distance from the given position that is more than the error of a placed skeleton, metres
MAX_SHIFT = 0.04


class JointEvidence(NamedTuple):
    """What the meshes show of the joints below the root, one row for each."""

    names: tuple[str, ...]
    #: indices of the joints in the skeleton
    joints: Int[np.ndarray, "N"]
    #: the row of the joint on the other side; -1 if there is none
    partners: Int[np.ndarray, "N"]
    #: distance from the joint to its parent, metres
    lengths: Float[np.ndarray, "N"]
    #: largest rotation from the mean over the meshes, degrees
    rotations: Float[np.ndarray, "N"]
    #: distance from the given position, metres; zero if none was given
    shifts: Float[np.ndarray, "N"]
    #: whether the meshes determine the position, at least across one axis; else it stays where the given skeleton has it
    determined: Bool[np.ndarray, "N"]

    @property
    def largest_length_difference(self) -> float:
        """The largest difference of the lengths of two paired bones, as a share of the length."""
        rows = np.flatnonzero(self.partners >= 0)
        pair = self.lengths[rows], self.lengths[self.partners[rows]]
        return float(
            np.max(np.abs(pair[0] - pair[1]) / np.maximum(np.maximum(*pair), MIN_LENGTH), initial=0.0)
        )


@checked
def joint_evidence(
    skeleton: Skeleton,
    motion: Motion,
    pairs: Int[np.ndarray, "P 2"],
    given: GivenCentres | None = None,
    least: float = MIN_ROTATION_GIVEN,
) -> JointEvidence:
    """Collect the lengths of bones and the rotations of joints over the meshes.

    A joint that rotates about one axis or more determines its centre in two directions. It is `determined` if the meshes
    weigh more there than the prior at the given position does.

    **Arguments:** `pairs` of left and right joints; `given` are the positions of the prior, on the rest pose of the skeleton;
    `least` mean squared rotation, squared radians, that determines a centre (`rotation_that_determines`).
    """
    centres, parents = np.asarray(skeleton.centres, float), np.array(skeleton.parents)
    joints = np.flatnonzero(parents >= 0)
    _, values, _ = motion_information(motion.poses)
    information = np.maximum(values[:, 1], 0.0)
    shares = information / (information + given_pull(information, least_rotations(skeleton, least)[:, 1]))
    if given is not None and given.is_fixed:
        shares = np.zeros(len(parents))
    before = centres if given is None else np.asarray(given.centres, float)
    partners = np.full(len(parents), -1)
    for left, right in np.asarray(pairs, int).reshape(-1, 2):
        partners[left], partners[right] = right, left
    rows = np.cumsum(parents >= 0) - 1
    return JointEvidence(
        tuple(skeleton.names[joint] for joint in joints),
        joints,
        np.where(partners[joints] >= 0, rows[partners[joints]], -1),
        np.linalg.norm(centres[joints] - centres[parents[joints]], axis=1),
        largest_rotations(np.asarray(motion.poses.rotations, float))[joints],
        np.linalg.norm(centres - before, axis=1)[joints],
        np.asarray(shares[joints] > MIN_SHARE),
    )


def largest_rotations(rotations: Float[np.ndarray, "F J 4"]) -> Float[np.ndarray, "J"]:
    """Compute the largest angle of each joint from the mean of its rotations, degrees."""
    means = np.linalg.eigh(np.einsum("fja,fjb->jab", rotations, rotations))[1][..., -1]
    cosines = np.abs(np.einsum("fja,ja->fj", rotations, means))
    return np.degrees(2 * np.arccos(np.clip(cosines, 0, 1))).max(0)


def describe_joints(evidence: JointEvidence, was_given: bool) -> list[str]:
    """Format a table of the joints, left next to right.

    Bones of no length, such as those that carry the hips, are left out. `was_given` adds a column with the source of the
    positions.
    """
    rows = [("joint", "bone, mm", "rotates", "position from" if was_given else "")]
    done: set[int] = set()
    for row, partner in enumerate(evidence.partners.tolist()):
        if row in done or evidence.lengths[row] < MIN_LENGTH:
            continue
        group = [row] if partner < 0 else [row, partner]
        done |= set(group)
        rows.append(
            (
                " / ".join(evidence.names[i] for i in group),
                " / ".join(f"{1000 * evidence.lengths[i]:.0f}" for i in group),
                " / ".join(f"{evidence.rotations[i]:.0f}°" for i in group),
                " / ".join(_source(evidence, i) for i in group) if was_given else "",
            )
        )
    widths = [max(len(cells[column]) for cells in rows) for column in range(4)]
    return [
        "  ".join(
            [cells[0].ljust(widths[0]), cells[1].rjust(widths[1]), cells[2].rjust(widths[2]), cells[3]]
        ).rstrip()
        for cells in rows
    ]


def far_joints(evidence: JointEvidence) -> list[str]:
    """Return one sentence about joints that the meshes moved by more than `MAX_SHIFT`."""
    rows = np.flatnonzero(evidence.shifts > MAX_SHIFT)
    if not len(rows):
        return []
    listed = ", ".join(f"{evidence.names[row]} ({1000 * evidence.shifts[row]:.0f} mm)" for row in rows)
    return [
        f"The meshes moved joints far from where the person has them: {listed}; clothes that slide can be the reason; "
        "compare with the joints of --fix-joints."
    ]


def _source(evidence: JointEvidence, row: int) -> str:
    return f"meshes ({1000 * evidence.shifts[row]:.0f} mm)" if evidence.determined[row] else "anatomy"
