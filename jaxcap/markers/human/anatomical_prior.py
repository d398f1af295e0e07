"""A prior of skeletons and marker placements: how people differ, and how exactly markers are placed.

`s = G t + bones + placements`: people differ along the modes `G` of the human's traits (sex, age, weight,
muscle, stature), with `t` standard normal. What the traits leave of each bone is normal, and nearly equal on
the left and the right. Each marker is off its landmark by a placement error.
"""

import numpy as np
from jaxtyping import Float, Int

from ...body.skeleton import Skeleton
from ...body.symmetry import find_left_right_pairs
from ...geometry.linear import pseudo_inverse
from ..calibration.calibration_parameters import (
    AbstractTemplatePrior,
    bone_and_placement_jacobian,
    bone_vectors,
)
from ..subject import Subject

#: standard deviation of each coordinate of a bone that people of equal traits have, as a share of its length and in
#: metres. Of ANSUR II's lengths of segments (Gordon and others 2014), stature explains all but 3 to 5 %
BONE_SHARE, BONE_DEVIATION = 0.035, 0.004
#: the share of children, whose proportions change as they grow, at other ages in each; the body of a child is an artist's, of
#: ten years, and no published survey has lengths between joint centres of both sexes and all ages
CHILD_BONE_SHARE = 0.07
#: standard deviation of the difference between a left and a right bone, as a share of the above. Bones of the two
#: sides differ by 1 % (Auerbach and Ruff 2006)
ASYMMETRY = 0.25


class AnatomicalPrior(AbstractTemplatePrior):
    """The prior of a person's skeleton and markers about a template of the embedded human, metres."""

    #: change of each centre and of each marker's rest position by one standard deviation of each of T traits
    centre_modes: Float[np.ndarray, "T J 3"]
    marker_modes: Float[np.ndarray, "T M 3"]
    #: standard deviation of each coordinate of a marker's position relative to the joint that its landmark is near
    placements: Float[np.ndarray, "M"]
    #: these joints, such as the knee for a marker on an epicondyle of the thigh
    anchors: Int[np.ndarray, "M"]
    #: standard deviation of each coordinate of a bone as a share of its length
    bone_share: float = BONE_SHARE

    def precision(self, template, joints):
        free = self.precision_without_traits(template, joints)
        modes = self.trait_modes(joints)
        # Woodbury: the inverse of the sum of the covariances
        pull = free @ modes
        inner = np.eye(modes.shape[1]) + modes.T @ pull
        return free - pull @ pseudo_inverse(inner, symmetric=True) @ pull.T

    def groups(self, template, joints):
        return None

    def trait_modes(self, joints: tuple[int, ...]) -> Float[np.ndarray, "S T"]:
        """Compute the change of `s` by each trait."""
        wide = np.concatenate([self.centre_modes[:, list(joints)], self.marker_modes], axis=1)
        return wide.reshape(len(wide), -1).T

    def precision_without_traits(
        self, template: Subject, joints: tuple[int, ...]
    ) -> Float[np.ndarray, "S S"]:
        """Compute the inverse covariance of `s` of people with equal traits."""
        bones = bone_vectors(template.skeleton, joints)
        deviations = self.bone_share * np.linalg.norm(bones, axis=1) + BONE_DEVIATION
        jacobian = bone_and_placement_jacobian(template, joints, self.anchors)
        count = len(joints)
        by_bone, by_marker = jacobian[:count], jacobian[count:] / self.placements[:, None]
        partners = _partners(template.skeleton, joints)
        rows = []
        for axis in range(3):
            mixed = _bone_factor(deviations, partners, -1.0 if axis == 0 else 1.0) @ by_bone
            scaled = np.vstack([mixed, by_marker])
            rows.append(scaled.T @ scaled)
        size = jacobian.shape[1]
        result = np.zeros((size, 3, size, 3))
        for axis, matrix in enumerate(rows):
            result[:, axis, :, axis] = matrix
        return result.reshape(3 * size, 3 * size)

    def estimate_traits(
        self, template: Subject, joints: tuple[int, ...], shared: Float[np.ndarray, "S"]
    ) -> Float[np.ndarray, "T"]:
        """Estimate the traits of a person with the shared unknowns `s`, in standard deviations."""
        free, modes = self.precision_without_traits(template, joints), self.trait_modes(joints)
        pull = modes.T @ free
        return pseudo_inverse(np.eye(modes.shape[1]) + pull @ modes, symmetric=True) @ (pull @ shared)


def _partners(skeleton: Skeleton, joints: tuple[int, ...]) -> Int[np.ndarray, "P 2"]:
    pairs = find_left_right_pairs(skeleton)
    return np.array(
        [
            (joints.index(left), joints.index(right))
            for left, right in pairs
            if left in joints and right in joints
        ],
        int,
    ).reshape(-1, 2)


def _bone_factor(
    deviations: Float[np.ndarray, "K"], partners: Int[np.ndarray, "P 2"], mirrored: float
) -> Float[np.ndarray, "K K"]:
    """Compute a square root of the precision of one coordinate of all bones; the mean and the difference of a pair
    have deviations of their own. `mirrored` is the sign of the coordinate on the other side."""
    factor = np.diag(1.0 / deviations)
    for left, right in partners:
        usual = 0.5 * (deviations[left] + deviations[right])
        # (left + right) / 2 has the whole deviation, left - right the share of it
        factor[left, [left, right]] = np.array([0.5, 0.5 * mirrored]) / usual
        factor[right, [left, right]] = np.array([1.0, -mirrored]) / (ASYMMETRY * usual)
    return factor
