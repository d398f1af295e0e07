"""Precision of joint centres and marker positions, and a description of what the data do not determine."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.pose import Pose
from ...fit.linear_solvers.float64 import in_float64
from ...geometry.linear import pseudo_inverse
from ..robust import OUTLIER_BOUND
from ..subject import Subject
from .calibration_parameters import centre_jacobian, equal_length_constraints
from .calibration_problem import CalibrationEstimate, CalibrationProblem
from .gauge_freedom import remove_gauge

#: a direction is imprecise with a larger standard deviation, metres
IMPRECISE_DEVIATION = 0.01
#: and determined by the template more than by the data where its deviation rises by this factor when the
#: template's deviations are doubled; the factor is two at most
PRIOR_DOMINATED_RATIO = 1.4
#: smaller deviations are not reported, metres
MIN_REPORTED_DEVIATION = 0.003


class SharedCovariances(NamedTuple):
    """Covariances of `s` (`jaxcap.markers.calibration.calibration_parameters`), metres squared."""

    #: with the data and the template's prior
    covariance: Float[np.ndarray, "S S"]
    #: with the deviations of the template's prior doubled
    with_weak_prior: Float[np.ndarray, "S S"]


class ImpreciseDirection(NamedTuple):
    """A direction, at rest, along which a joint's centre is imprecise."""

    joint: int
    direction: Float[np.ndarray, "3"]
    #: metres
    deviation: float
    #: true if the data determine it more than the template
    is_determined_by_data: bool


def shared_covariance(problem: CalibrationProblem, estimate: CalibrationEstimate) -> SharedCovariances:
    """Compute the covariance of `s` at a fitted subject.

    It is the inverse of the Schur complement of all poses, with the template's prior. Bones of equal length
    have no variance in their difference.
    """
    # outliers are weighted by this kernel, also where the fit was not robust
    problem = eqx.tree_at(
        lambda p: p.outlier_bound, problem, jnp.asarray(OUTLIER_BOUND, problem.outlier_bound.dtype)
    )
    both, loose = (np.asarray(part, float) for part in in_float64(_compute_covariances, problem, estimate))
    if problem.left_right_pairs:
        rows = np.asarray(
            equal_length_constraints(problem.subject(estimate), problem.joints, problem.left_right_pairs)[0],
            float,
        )
        both, loose = (_condition_on(covariance, rows) for covariance in (both, loose))
    return SharedCovariances(both, loose)


@eqx.filter_jit
def _compute_covariances(
    problem: CalibrationProblem, estimate: CalibrationEstimate
) -> tuple[Float[Array, "S S"], Float[Array, "S S"]]:
    """Compute the covariance with the whole prior, and with a quarter of it."""
    size = len(problem.prior)
    weak = eqx.tree_at(lambda p: p.prior, problem, 0.25 * problem.prior)
    both, loose = (each.shared_covariance(estimate)[:size, :size] for each in (problem, weak))
    return both, loose


def _condition_on(
    covariance: Float[np.ndarray, "S S"], rows: Float[np.ndarray, "C S"]
) -> Float[np.ndarray, "S S"]:
    """Condition a covariance on exact linear constraints."""
    across = covariance @ rows.T
    return covariance - across @ pseudo_inverse(rows @ across) @ across.T


def bone_length_deviations(
    subject: Subject, joints: tuple[int, ...], covariance: Float[np.ndarray, "S S"]
) -> Float[np.ndarray, "J"]:
    """Compute the standard deviation of the length of the bone from each joint's parent to it, metres.

    NaN where the joint's own centre is not solved, or where its parent is not, as at a root with an
    arbitrary centre.
    """
    skeleton = subject.skeleton
    rows, centres = centre_jacobian(skeleton, joints), np.asarray(skeleton.centres, float)
    result = np.full(skeleton.num_joints, np.nan)
    size = 3 * len(joints)
    for joint in joints:
        parent = skeleton.parents[joint]
        if parent not in joints:
            continue
        along = centres[joint] - centres[parent]
        along = along / max(np.linalg.norm(along), 1e-12)
        slope = np.kron(rows[joint] - rows[parent], along)
        result[joint] = np.sqrt(max(slope @ covariance[:size, :size] @ slope, 0.0))
    return result


def centre_covariances(
    subject: Subject, joints: tuple[int, ...], covariance: Float[np.ndarray, "S S"]
) -> Float[np.ndarray, "K 3 3"]:
    """Compute the covariance of each solved centre relative to the markers of its parent's bone.

    If that bone has no markers, the nearest ancestor with markers replaces it. Metres squared, along the
    axes of the world at rest.
    """
    free = remove_gauge(subject, joints, covariance)
    skeleton, bones = subject.skeleton, np.asarray(subject.bones)
    weights = np.asarray(subject.weights) > 0
    count = len(joints) + subject.num_markers
    result = np.zeros((len(joints), 3, 3))
    for row, joint in enumerate(joints):
        bone = skeleton.parents[joint]
        while skeleton.parents[bone] >= 0 and not (weights & (bones == bone)).any():
            bone = skeleton.parents[bone]
        markers = np.flatnonzero(weights & (bones == bone))
        pick = np.zeros(count)
        pick[row] = 1.0
        pick[len(joints) + markers] -= 1.0 / max(len(markers), 1)
        wide = np.kron(pick, np.eye(3))
        result[row] = wide @ free @ wide.T
    return result


def find_imprecise_directions(
    subject: Subject, shared_covariances: SharedCovariances, joints: tuple[int, ...]
) -> list[ImpreciseDirection]:
    """List the directions of centres with a deviation of at least `IMPRECISE_DEVIATION`, or determined by the template."""
    found = []
    covariances = (centre_covariances(subject, joints, each) for each in shared_covariances)
    for joint, covariance, loose in zip(joints, *covariances, strict=True):
        values, vectors = np.linalg.eigh(covariance)
        for value, direction in zip(values[::-1], vectors.T[::-1], strict=True):
            deviation = float(np.sqrt(max(value, 0.0)))
            by_data = float(np.sqrt(direction @ loose @ direction)) < PRIOR_DOMINATED_RATIO * deviation
            if deviation >= IMPRECISE_DEVIATION or (not by_data and deviation > MIN_REPORTED_DEVIATION):
                found.append(ImpreciseDirection(joint, direction, deviation, by_data))
    return found


def describe_precision(
    subject: Subject,
    shared_covariances: SharedCovariances,
    poses: Pose,
    joints: tuple[int, ...],
    imprecise_directions: Sequence[ImpreciseDirection],
) -> list[str]:
    """Describe each imprecise direction in a sentence: of joints' centres, and of the overall size."""
    skeleton = subject.skeleton
    said = []
    silent = [
        name
        for joint, name in enumerate(skeleton.names)
        if joint not in joints and skeleton.parents[joint] >= 0 and skeleton.kinds[joint] not in ("fixed",)
    ]
    if silent:
        said.append(
            f"No markers determine the centres of {', '.join(silent)}; their bones keep the lengths of the "
            "template."
        )
    for joint, direction, deviation, by_data in imprecise_directions:
        where = _describe_direction(subject, poses, joint, direction)
        if by_data:
            said.append(
                f"{where}, the centre of {skeleton.names[joint]} has a standard deviation of "
                f"{1000 * deviation:.0f} mm."
            )
        else:
            said.append(
                f"{where}, the data do not determine the centre of {skeleton.names[joint]}: it is that of "
                f"the template, with a standard deviation of {1000 * deviation:.0f} mm."
            )
    size = _size_deviation(subject, joints, shared_covariances.covariance)
    if size > 0.01:
        said.append(
            f"The overall size of the skeleton has a standard deviation of {100 * size:.1f} %: longer "
            "bones, with markers at other positions on them, would fit equally well."
        )
    return said


def _describe_direction(subject: Subject, poses: Pose, joint: int, direction: np.ndarray) -> str:
    """Describe a direction at rest: the joint's axis of rotation, its bone, or numbers."""
    skeleton = subject.skeleton
    q = np.asarray(poses.rotations[:, joint], float)
    middle = np.linalg.eigh(q.T @ q)[1][:, -1]
    signed = q * np.where(q @ middle < 0, -1.0, 1.0)[:, None]
    # vector parts of conj(middle) q: half the rotation vectors from the mean, in the bone's own frame at
    # rest
    w, v = middle[0], middle[1:]
    turns = w * signed[:, 1:] - signed[:, :1] * v - np.cross(v, signed[:, 1:])
    values, axes = np.linalg.eigh(turns.T @ turns / len(turns))
    if values[2] < np.radians(3.0) ** 2 / 4:
        return "As its joint hardly rotates"
    if abs(axes[:, 2] @ direction) > 0.85 and values[1] < 0.25 * values[2]:
        return "Along the axis of rotation"
    parent = skeleton.parents[joint]
    bone = np.asarray(skeleton.centres[joint] - skeleton.centres[parent], float)
    if abs(bone @ direction) > 0.85 * np.linalg.norm(bone) > 0:
        return f"Along the bone from {skeleton.names[parent]}"
    x, y, z = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return f"Along ({x:.2f}, {y:.2f}, {z:.2f}) at rest"


def _size_deviation(subject: Subject, joints: tuple[int, ...], covariance) -> float:
    """Compute the relative standard deviation of the sum of all solved bones' lengths."""
    skeleton = subject.skeleton
    rows, centres = centre_jacobian(skeleton, joints), np.asarray(skeleton.centres, float)
    inner = [joint for joint in joints if skeleton.parents[joint] in joints]
    if not inner:
        return 0.0
    slope, total = np.zeros(3 * len(joints)), 0.0
    for joint in inner:
        parent = skeleton.parents[joint]
        along = centres[joint] - centres[parent]
        length = np.linalg.norm(along)
        slope += np.kron(rows[joint] - rows[parent], along / max(length, 1e-12))
        total += float(length)
    return float(
        np.sqrt(max(slope @ covariance[: len(slope), : len(slope)] @ slope, 0.0)) / max(total, 1e-12)
    )
