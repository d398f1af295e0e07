"""Skin that slides on its bone as the adjacent joints rotate: a soft tissue model.

Each marker's rest position shifts linearly with the rotations of the joints at both ends of its bone, as
soft tissue mostly does (Camomilla, Cereatti, Cutti and others 2013; Bonci and others 2014):

    o_m(f) = o_m + sum_k phi_mk(f) d_mk

`phi` are the rotations about their means, along the few directions with the largest variance, radians. A
shift that follows a joint is similar to a shift of the centre. Without this model it is mistaken for one,
with more certainty the more frames there are. `d` is unknown with a prior at zero. Its deviation, one for each bone and
direction, maximises the marginal likelihood (`jaxcap.markers.calibration.prior_scales`). So what the data cannot separate
counts as unknown.

Skin also follows joints in other directions, and not linearly. This part is less than the noise in each frame, so no fit
shows it, but it is the same whenever a pose returns. Covariances include it as further features with unknown slides of
mean zero (`further_features`).
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.pose import Pose
from ...body.skeleton import Skeleton
from ...geometry.linear import pseudo_inverse
from ..subject import Subject
from .rotation_prior import rotation_vectors_from_mean

#: number of directions for the markers of a bone
NUM_DIRECTIONS = 4
#: number of further directions for covariances
NUM_FURTHER_DIRECTIONS = 8
#: rotations have to explain this multiple of what chance explains of the residuals
MIN_EXPLAINED_RATIO = 6.0
#: lower and upper limit of the standard deviation of skin sliding, metres a radian. Markers on a thigh move by up to 3 cm
#: as hip and knee bend by a radian, other markers by less (Leardini and others 2005; Peters and others 2010)
MIN_SLIDING, MAX_SLIDING = 2e-4, 0.03
#: approximate distance of markers from the centroid of their bone's markers, metres
MARKER_LEVER = 0.05


def skin_shifts(
    features: Float[np.ndarray, "F M K"], slides: Float[np.ndarray, "K M 3"]
) -> Float[np.ndarray, "F M 3"]:
    """Compute the shift of each marker from its rest position, metres."""
    return np.einsum("fmk,kma->fma", features, slides)


def shift_variances(
    features: Float[np.ndarray, "F M K"], slides: Float[np.ndarray, "K M 3"]
) -> Float[np.ndarray, "M"]:
    """Compute mean squares of the shifts along each axis, metres squared."""
    return np.mean(skin_shifts(features, slides) ** 2, (0, 2))


def skin_features(subject: Subject, poses: Pose) -> Float[np.ndarray, "F M K"]:
    """Compute the features of every marker: rotations of the joints at both ends of its bone, radians."""
    skeleton, bones = subject.skeleton, np.asarray(subject.bones)
    rotations = np.asarray(poses.rotations, float)
    angles = 2 * np.arccos(np.clip(np.abs(rotations[..., :1]), 0, 1))
    turns = np.concatenate([rotation_vectors_from_mean(rotations), angles], 2)
    features = np.zeros((len(turns), len(bones), NUM_DIRECTIONS))
    for bone, wide in _turns_of_bones(skeleton, bones, turns):
        features[:, bones == bone] = _leading_components(wide - wide.mean(0), NUM_DIRECTIONS)[:, None]
    return features


def further_features(
    subject: Subject, poses: Pose, features: Float[np.ndarray, "F M K"]
) -> Float[np.ndarray, "F M E"]:
    """Compute what `features` leave of the rotations of both ends of a bone and of the products of two of them.

    A shift that changes by its own size over a radian has equal slides with both. The directions are those with the largest
    variance.
    """
    skeleton, bones = subject.skeleton, np.asarray(subject.bones)
    turns = rotation_vectors_from_mean(np.asarray(poses.rotations, float))
    further = np.zeros((len(turns), len(bones), NUM_FURTHER_DIRECTIONS))
    for bone, wide in _turns_of_bones(skeleton, bones, turns):
        first, second = np.triu_indices(wide.shape[1])
        wide = np.concatenate([wide, wide[:, first] * wide[:, second]], 1)
        known = features[:, bones == bone][:, 0]
        wide, known = wide - wide.mean(0), known - known.mean(0)
        wide = wide - known @ (pseudo_inverse(known, 1e-6) @ wide)
        further[:, bones == bone] = _leading_components(wide, NUM_FURTHER_DIRECTIONS)[:, None]
    return further


def _turns_of_bones(
    skeleton: Skeleton, bones: Int[np.ndarray, "M"], turns: Float[np.ndarray, "F J T"]
) -> Iterator[tuple[int, Float[np.ndarray, "F A"]]]:
    """Yield each bone with the rotations of the joints at both of its ends; roots do not move skin."""
    for bone in map(int, np.unique(bones)):
        ends = [joint for joint, parent in enumerate(skeleton.parents) if parent == bone]
        adjacent = ends + ([bone] if skeleton.parents[bone] >= 0 else [])
        if adjacent:
            yield bone, turns[:, adjacent].reshape(len(turns), -1)


def _leading_components(values: Float[np.ndarray, "F A"], count: int) -> Float[np.ndarray, "F {count}"]:
    """Compute the components of centred values along the directions with the largest variance, zero beyond their number."""
    _, _, directions = np.linalg.svd(values, full_matrices=False)
    found = values @ directions[:count].T
    return np.pad(found, ((0, 0), (0, count - found.shape[1])))


def initial_slide_deviation(
    features: Float[np.ndarray, "F M K"],
    residuals: Float[np.ndarray, "F M 3"],
    seen: Bool[np.ndarray, "F M"],
) -> float | None:
    """Estimate the standard deviation of every number of `d`, metres a radian.

    None where the residuals do not follow the joints by more than chance.
    """
    explained = whole = chance = squares = 0.0
    for marker in range(residuals.shape[1]):
        some = seen[:, marker]
        phi, left = features[some, marker], residuals[some, marker]
        phi = phi[:, (phi**2).sum(0) > 1e-9]
        if len(left) <= 2 * phi.shape[1] or not phi.size:
            continue
        phi, left = phi - phi.mean(0), left - left.mean(0)
        projected = float(np.sum((phi @ (pseudo_inverse(phi, 1e-6) @ left)) ** 2))
        explained, whole = explained + projected, whole + float(np.sum(left**2))
        chance += phi.shape[1] / len(left) * float(np.sum(left**2))
        squares += float(np.sum(phi**2)) * 3
    if whole == 0.0 or explained < MIN_EXPLAINED_RATIO * chance:
        return None
    return float(np.clip(np.sqrt(explained / squares), MIN_SLIDING, MAX_SLIDING))


def align_features(
    old: Float[np.ndarray, "F M K"], new: Float[np.ndarray, "F M K"]
) -> Float[np.ndarray, "F M K"]:
    """Rotate new features towards the old ones, so that each keeps the deviation of its slides (orthogonal Procrustes)."""
    left, _, right = np.linalg.svd(np.einsum("fma,fmb->mab", new, old))
    return np.einsum("fma,mab->fmb", new, left @ right)


def refit_slides(
    old: Float[np.ndarray, "F M K"], slides: Float[np.ndarray, "K M 3"], new: Float[np.ndarray, "F M K"]
) -> Float[np.ndarray, "K M 3"]:
    """Find the slides that shift the markers with new features as nearly as possible as with the old ones."""
    result = np.zeros_like(slides)
    for marker in range(slides.shape[1]):
        shifts = old[:, marker] @ slides[:, marker]
        result[:, marker] = pseudo_inverse(new[:, marker], 1e-6) @ shifts
    return result


class RelativeModes(NamedTuple):
    """Unit shifts of the markers of a bone that no rigid motion of the bone makes: R in all."""

    #: shift of each marker along each axis
    rows: Float[Array, "R N"]
    #: the bone of each, and a marker on it
    bones: Int[Array, "R"]
    markers: Int[Array, "R"]


def relative_modes(subject: Subject) -> RelativeModes:
    """Find an orthonormal basis of the shifts of each bone's markers relative to each other.

    Only joints contradict slides that move all markers of a bone rigidly, as the bone itself may have moved.
    """
    bones, offsets = np.asarray(subject.bones), np.asarray(subject.offsets, float)
    rows, owners, markers = [], [], []
    for bone in np.unique(bones):
        members = np.flatnonzero(bones == bone)
        arms = offsets[members] - offsets[members].mean(0)
        turns = np.cross(np.eye(3)[:, None], arms).reshape(3, -1) / MARKER_LEVER
        rigid = np.concatenate([turns, np.tile(np.eye(3), (1, len(members)))])
        _, sizes, basis = np.linalg.svd(rigid)
        kept = basis[np.count_nonzero(sizes > 1e-3) :]
        wide = np.zeros((len(kept), len(bones), 3))
        wide[:, members] = kept.reshape(len(kept), len(members), 3)
        rows.append(wide.reshape(len(kept), 3 * len(bones)))
        owners += [bone] * len(kept)
        markers += [members[0]] * len(kept)
    return RelativeModes(jnp.asarray(np.concatenate(rows)), jnp.array(owners, int), jnp.array(markers, int))
