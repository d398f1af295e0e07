"""Parameters `s` that all frames share: the joints' centres and the markers' rest positions, metres.

`s` has three numbers for each solved joint's centre, then three for each marker's rest position, as
differences from a template. A joint is solved if it rotates and has markers on both sides. The centres of
the others move with their parents.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.skeleton import Skeleton
from ...body.symmetry import length_differences
from ..subject import Subject


class PriorGroups(NamedTuple):
    """Independent normal priors of linear functions of `s`, in groups with a common unknown scale."""

    #: each function of `s`, in units of its standard deviation at a scale of one
    rows: Float[np.ndarray, "N S"]
    #: the group of each, from 0
    groups: Int[np.ndarray, "N"]


class AbstractTemplatePrior(eqx.Module):
    """A normal prior of `s` about a template."""

    @abc.abstractmethod
    def precision(self, template: Subject, joints: tuple[int, ...]) -> Float[np.ndarray, "S S"]:
        """Compute the inverse covariance of `s`, for the given solved joints."""

    @abc.abstractmethod
    def groups(self, template: Subject, joints: tuple[int, ...]) -> PriorGroups | None:
        """Divide the prior into groups with deviations that the data choose; None if all are given.

        The sum of squares of all rows is the prior of `precision`.
        """


class TemplatePrior(AbstractTemplatePrior):
    """Uncertainty of any template, as standard deviations of its bones and of the markers on them.

    The prior means are the template's bones and its marker positions *on their bones*, so that a longer bone
    shifts all below it. The prior determines what no motion does, and is negligible where a motion does.

    If `adaptive`, the deviations are upper limits for three groups: lengths of bones, their directions, and placements. The
    scale of each group, from 0.05 to 1, maximises the marginal likelihood, where the given deviations count as two numbers
    (`jaxcap.markers.calibration.prior_scales`). So a template with the right directions and other lengths determines the centres
    of hinges along their axes.
    """

    #: of each coordinate of a bone, as a share of its length
    lengths: float = eqx.field(static=True, default=0.1)
    #: of each coordinate of a bone, an additional part in metres
    joints: float = eqx.field(static=True, default=0.01)
    #: of each coordinate of a marker's position on its bone, metres
    placements: float = eqx.field(static=True, default=0.02)
    #: false keeps these deviations
    adaptive: bool = eqx.field(static=True, default=True)

    def precision(self, template, joints):
        rows, _ = self._rows_and_groups(template, joints)
        return rows.T @ rows

    def groups(self, template, joints):
        return PriorGroups(*self._rows_and_groups(template, joints)) if self.adaptive else None

    def _rows_and_groups(self, template: Subject, joints: tuple[int, ...]):
        bones = bone_vectors(template.skeleton, joints)
        lengths, count = np.linalg.norm(bones, axis=1), template.num_markers
        deviations = np.append(self.lengths * lengths + self.joints, np.full(count, self.placements))
        scaled = bone_and_placement_jacobian(template, joints) / deviations[:, None]
        # the axes of a bone: along it, and two across it; those of markers are the world's
        axes = np.tile(np.eye(3), (len(scaled), 1, 1))
        for bone, vector in enumerate(bones):
            axes[bone] = np.linalg.svd(vector[None])[2]
        rows = np.einsum("ns,nab->nasb", scaled, axes).reshape(3 * len(scaled), -1)
        groups = np.concatenate([np.tile([0, 1, 1], len(bones)), np.full(3 * count, 2)])
        return rows, groups


def solved_joints(subject: Subject, used: Bool[np.ndarray, "M"]) -> tuple[int, ...]:
    """List the joints with centres that markers can determine.

    They rotate, and have used markers both below and elsewhere.
    """
    skeleton = subject.skeleton
    below = (skeleton.descendants[:, np.asarray(subject.bones)] & np.asarray(used)).sum(1)
    return tuple(
        joint
        for joint, (parent, kind) in enumerate(zip(skeleton.parents, skeleton.kinds, strict=True))
        if parent >= 0 and kind not in ("fixed", "translate") and 0 < below[joint] < np.sum(used)
    )


def centre_jacobian(skeleton: Skeleton, joints: tuple[int, ...]) -> Float[np.ndarray, "J K"]:
    """Map each centre to the solved joint that it moves with: itself, or the nearest ancestor; a root is
    fixed."""
    rows = np.zeros((skeleton.num_joints, len(joints)))
    for joint, parent in enumerate(skeleton.parents):
        if joint in joints:
            rows[joint, joints.index(joint)] = 1.0
        elif parent >= 0:
            rows[joint] = rows[parent]
    return rows


def shift_subject(subject: Subject, joints: tuple[int, ...], shared: Float[Array, "S"]) -> Subject:
    """Shift the subject's centres and rest positions by `shared`."""
    skeleton, count = subject.skeleton, 3 * len(joints)
    rows = jnp.asarray(centre_jacobian(skeleton, joints), shared.dtype)
    centres = skeleton.centres + rows @ shared[:count].reshape(-1, 3)
    offsets = subject.offsets + shared[count:].reshape(-1, 3)
    return eqx.tree_at(lambda s: (s.skeleton.centres, s.offsets), subject, (centres, offsets))


def shared_parameters(template: Subject, subject: Subject, joints: tuple[int, ...]) -> Float[Array, "S"]:
    """Compute the `s` that maps the template to the subject."""
    shifts = (subject.skeleton.centres - template.skeleton.centres)[np.array(joints, int)]
    return jnp.concatenate([shifts.ravel(), (subject.offsets - template.offsets).ravel()])


def bone_vectors(skeleton: Skeleton, joints: tuple[int, ...]) -> Float[np.ndarray, "K 3"]:
    """Compute the vector at rest from the parent of each solved joint to it, metres."""
    centres = np.asarray(skeleton.centres, float)
    parents = np.array([skeleton.parents[joint] for joint in joints], int)
    return centres[list(joints)] - centres[parents]


def bone_and_placement_jacobian(
    template: Subject, joints: tuple[int, ...], anchors: Int[np.ndarray, "M"] | None = None
) -> Float[np.ndarray, "N N"]:
    """Map `s`, an axis at a time, to changes of the solved bones and of the markers relative to joints.

    `anchors (M,)`, the joint of each marker, by default that of its bone.
    """
    anchors = np.asarray(template.bones) if anchors is None else anchors
    skeleton = template.skeleton
    rows = centre_jacobian(skeleton, joints)
    parents = np.array([skeleton.parents[joint] for joint in joints], int)
    bones = rows[list(joints)] - rows[parents]
    by_joint = np.hstack([bones, np.zeros((len(joints), template.num_markers))])
    by_marker = np.hstack([-rows[anchors], np.eye(template.num_markers)])
    return np.vstack([by_joint, by_marker])


def parameter_names(template: Subject, joints: tuple[int, ...], num_features: int) -> tuple[str, ...]:
    """Name each number of `s`, and of the sliding of skin with each feature."""
    centres = [f"centre of {template.skeleton.names[joint]}" for joint in joints]
    markers = [f"marker {label}" for label in template.labels]
    slides = [
        f"sliding of {label} with feature {number}"
        for number in range(num_features)
        for label in template.labels
    ]
    return tuple(f"{name}.{axis}" for name in (*centres, *markers, *slides) for axis in "xyz")


def equal_length_constraints(
    subject: Subject, joints: tuple[int, ...], pairs: tuple[tuple[int, int], ...]
) -> tuple[Float[Array, "B S"], Float[Array, "B"]]:
    """Compute the rows over `s` that keep paired bones equally long, and their right sides."""
    differences, slopes = length_differences(subject.skeleton, np.array(pairs, int).reshape(-1, 2))
    by_centre = jnp.einsum("bja,jk->bka", slopes, centre_jacobian(subject.skeleton, joints))
    rows = jnp.pad(by_centre.reshape(len(slopes), -1), ((0, 0), (0, 3 * subject.num_markers)))
    return rows, -differences
