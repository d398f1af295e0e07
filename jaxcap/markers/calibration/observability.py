"""Precision of joint centres and marker positions, and a description of what the data do not determine."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...body.pose import Pose
from ...fit.linear.precision import in_double
from ..subject import Subject
from .calibration_parameters import constraint_rows, followers
from .gauge_freedom import without_gauge
from .problem import CalibrationEstimate, CalibrationProblem
from .robust import BOUND

#: a direction is imprecise with a larger standard deviation, metres
HARDLY = 0.01
#: and determined by the template more than by the data where its deviation rises by this factor when the
#: template's deviations are doubled; the factor is two at most
UNTOLD = 1.4
#: smaller deviations are not reported, metres
SMALL = 0.003


class Known(NamedTuple):
    """Covariances of `s` (`jaxcap.markers.calibration.calibration_parameters`), metres squared."""

    #: with the data and the template's prior
    covariance: Float[np.ndarray, "S S"]
    #: with the deviations of the template's prior doubled
    loose: Float[np.ndarray, "S S"]


class Hardly(NamedTuple):
    """A direction, at rest, along which a joint's centre is imprecise."""

    joint: int
    direction: Float[np.ndarray, "3"]
    #: metres
    deviation: float
    #: true if the data determine it more than the template
    told: bool


def shared_covariance(problem: CalibrationProblem, estimate: CalibrationEstimate) -> Known:
    """Compute the covariance of `s` at a fitted subject.

    It is the inverse of the Schur complement of all poses, with the template's prior. Bones of equal length
    have no variance in their difference.
    """
    # outliers are weighted by this kernel, also where the fit was not robust
    problem = eqx.tree_at(lambda p: p.bound, problem, jnp.asarray(BOUND, problem.bound.dtype))
    both, loose = (np.asarray(part, float) for part in in_double(_covariances, problem, estimate))
    if problem.pairs:
        rows = np.asarray(constraint_rows(problem.subject(estimate), problem.joints, problem.pairs)[0], float)
        both, loose = (_given(covariance, rows) for covariance in (both, loose))
    return Known(both, loose)


@eqx.filter_jit
def _covariances(
    problem: CalibrationProblem, estimate: CalibrationEstimate
) -> tuple[Float[Array, "S S"], Float[Array, "S S"]]:
    """Compute the covariance with the whole prior, and with a quarter of it."""
    size = len(problem.prior)
    arrow = problem.normal_equations(estimate)[2]
    taken = jnp.zeros_like(arrow.shared).at[:size, :size].set(0.75 * problem.prior)
    weak = eqx.tree_at(lambda a: a.shared, arrow, arrow.shared - taken)
    one = jnp.eye(len(arrow.shared), dtype=arrow.shared.dtype)
    both, loose = (each.factorise().shared.solve(one)[:size, :size] for each in (arrow, weak))
    return (both + both.T) / 2, (loose + loose.T) / 2


def _given(covariance: Float[np.ndarray, "S S"], rows: Float[np.ndarray, "C S"]) -> Float[np.ndarray, "S S"]:
    """Condition a covariance on exact linear constraints."""
    across = covariance @ rows.T
    return covariance - across @ np.linalg.pinv(rows @ across) @ across.T


def length_deviations(
    subject: Subject, joints: tuple[int, ...], covariance: Float[np.ndarray, "S S"]
) -> Float[np.ndarray, "J"]:
    """Compute the standard deviation of the length of the bone from each joint's parent to it, metres.

    NaN where the joint's own centre is not solved, or where its parent is not, as at a root with an
    arbitrary centre.
    """
    skeleton = subject.skeleton
    rows, centres = followers(skeleton, joints), np.asarray(skeleton.centres, float)
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
    free = without_gauge(subject, joints, covariance)
    skeleton, bones = subject.skeleton, np.asarray(subject.bones)
    weights = np.asarray(subject.weights) > 0
    count = len(joints) + subject.num_markers
    result = np.zeros((len(joints), 3, 3))
    for row, joint in enumerate(joints):
        bone = skeleton.parents[joint]
        while skeleton.parents[bone] >= 0 and not (weights & (bones == bone)).any():
            bone = skeleton.parents[bone]
        own = np.flatnonzero(weights & (bones == bone))
        pick = np.zeros(count)
        pick[row] = 1.0
        pick[len(joints) + own] -= 1.0 / max(len(own), 1)
        wide = np.kron(pick, np.eye(3))
        result[row] = wide @ free @ wide.T
    return result


def hardly_known(subject: Subject, known: Known, joints: tuple[int, ...]) -> list[Hardly]:
    """List the directions of centres with a deviation of at least `HARDLY`, or determined by the template."""
    found = []
    covariances = (centre_covariances(subject, joints, each) for each in known)
    for joint, covariance, loose in zip(joints, *covariances, strict=True):
        values, vectors = np.linalg.eigh(covariance)
        for value, direction in zip(values[::-1], vectors.T[::-1], strict=True):
            deviation = float(np.sqrt(max(value, 0.0)))
            told = float(np.sqrt(direction @ loose @ direction)) < UNTOLD * deviation
            if deviation >= HARDLY or (not told and deviation > SMALL):
                found.append(Hardly(joint, direction, deviation, told))
    return found


def describe_precision(
    subject: Subject, known: Known, poses: Pose, joints: tuple[int, ...], hardly: Sequence[Hardly]
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
    for joint, direction, deviation, told in hardly:
        where = _in_words(subject, poses, joint, direction)
        if told:
            said.append(
                f"{where}, the centre of {skeleton.names[joint]} has a standard deviation of "
                f"{1000 * deviation:.0f} mm."
            )
        else:
            said.append(
                f"{where}, the data do not determine the centre of {skeleton.names[joint]}: it is that of "
                f"the template, with a standard deviation of {1000 * deviation:.0f} mm."
            )
    size = _size_deviation(subject, joints, known.covariance)
    if size > 0.01:
        said.append(
            f"The overall size of the skeleton has a standard deviation of {100 * size:.1f} %: longer "
            "bones, with markers at other positions on them, would fit equally well."
        )
    return said


def _in_words(subject: Subject, poses: Pose, joint: int, direction: np.ndarray) -> str:
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
    rows, centres = followers(skeleton, joints), np.asarray(skeleton.centres, float)
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
