"""A performer as markers see them: a skeleton, and where on its bones the markers sit."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import check_fields, check_length, checked
from ..body.body import Body
from ..body.kinematics import forward_kinematics
from ..body.pose import Pose
from ..body.skeleton import Skeleton
from ..body.skin import LinearSkin

#: how a marker is held by its bone: at a point of it; on a circle about it; on a sphere about its joint
MODELS = ("rigid", "circle", "sphere")
#: standard deviation of a marker about its place, metres, where nothing has been measured
DEVIATION = 0.01


class Subject(eqx.Module):
    """A skeleton, whose rest pose has the performer's lengths, and M markers on its bones.

    `offsets` are the places of the markers in the world when the skeleton is at rest, as
    `BoneLandmarks.rest` are. A "circle" marker keeps its distance from its bone and its place along
    it, a "sphere" marker its distance from the joint that moves its bone.
    """

    skeleton: Skeleton
    bones: Int[Array, "M"]
    offsets: Float[Array, "M 3"]
    #: of attachment, 0 to 1; 0 is a marker that is not used
    weights: Float[Array, "M"]
    #: standard deviation of what is seen about what is predicted, metres along each axis
    deviations: Float[Array, "M"]
    labels: tuple[str, ...] = eqx.field(static=True)
    models: tuple[str, ...] = eqx.field(static=True)

    def __check_init__(self):
        lengths = check_fields(self)
        for name in ("labels", "models"):
            check_length(self, name, len(getattr(self, name)), lengths, "M")

    @property
    def num_markers(self) -> int:
        """M, the number of markers."""
        return len(self.labels)


@checked
def make_subject(
    skeleton: Skeleton,
    bones: Sequence[int] | np.ndarray,
    offsets,
    labels: Sequence[str],
    *,
    weights=None,
    deviations=None,
    models: Sequence[str] | None = None,
) -> Subject:
    """A checked `Subject`.

    **Arguments:** `bones (M,)` joint indices; `offsets (M, 3)` metres in the world at rest; `labels`
    each of them once; `weights (M,)` of attachment from 0 to 1, one where not given; `deviations (M,)`
    metres, a centimetre where not given; `models` out of `MODELS`, "rigid" where not given.

    **Raises:** `ValueError` with one sentence that names the marker.
    """
    count, dtype, labels = len(labels), skeleton.centres.dtype, tuple(labels)
    bones, offsets = np.asarray(bones), np.asarray(offsets, float)
    weights = np.ones(count) if weights is None else np.asarray(weights, float)
    deviations = np.full(count, DEVIATION) if deviations is None else np.asarray(deviations, float)
    models = ("rigid",) * count if models is None else tuple(models)
    shapes = bones.shape[:1], offsets.shape[:1], weights.shape, deviations.shape, (len(models),)
    if offsets.shape != (count, 3) or any(shape != (count,) for shape in shapes):
        raise ValueError(
            f"There are {count} labels, with bones of shape {bones.shape}, offsets {offsets.shape}, weights "
            f"{weights.shape}, deviations {deviations.shape} and {len(models)} models; give one of each a marker."
        )
    for marker, label in enumerate(labels):
        if labels.count(label) > 1:
            raise ValueError(f"The marker '{label}' stands twice; give every marker its own name.")
        if not 0 <= bones[marker] < skeleton.num_joints:
            raise ValueError(
                f"Marker '{label}' is on bone {bones[marker]}; there are bones 0 to {skeleton.num_joints - 1}."
            )
        if models[marker] not in MODELS:
            raise ValueError(f"Marker '{label}' has the model '{models[marker]}'; use {', '.join(MODELS)}.")
        if not np.isfinite(offsets[marker]).all():
            raise ValueError(f"The offset of marker '{label}' is not finite; give its place at rest.")
        if not 0 <= weights[marker] <= 1 or not 0 < deviations[marker] < np.inf:
            raise ValueError(
                f"Marker '{label}' has the weight {weights[marker]} and the deviation {deviations[marker]}; "
                "weights are from 0 to 1, deviations above 0 metres."
            )
    offsets, weights, deviations = (jnp.asarray(values, dtype) for values in (offsets, weights, deviations))
    return Subject(skeleton, jnp.asarray(bones, jnp.int32), offsets, weights, deviations, labels, models)


@checked
def marker_places(subject: Subject, pose: Pose) -> Float[Array, "M 3"]:
    """Where a pose puts the markers, metres; those on circles and spheres as if they were rigid."""
    transforms = forward_kinematics(subject.skeleton, pose)
    r, t = transforms.rotations[subject.bones], transforms.translations[subject.bones]
    return jnp.einsum("mab,mb->ma", r, subject.offsets) + t


@checked
def marker_body(subject: Subject) -> Body:
    """Make the body that a user's own terms see: the subject's skeleton, with its markers for vertices and no faces."""
    weights = jax.nn.one_hot(subject.bones, subject.skeleton.num_joints, dtype=subject.offsets.dtype)
    return Body(subject.skeleton, LinearSkin(weights), subject.offsets, jnp.zeros((0, 3), jnp.int32))


def shifted(subject: Subject, shifts: Float[Array, "M 3"]) -> Subject:
    """The subject with its markers elsewhere, metres at rest."""
    return eqx.tree_at(lambda s: s.offsets, subject, subject.offsets + shifts)


def scaled(subject: Subject, scale: float | Float[Array, ""]) -> Subject:
    """The subject `scale` times as large, about the root's centre at rest."""
    root = subject.skeleton.centres[0]
    centres, offsets = (root + scale * (x - root) for x in (subject.skeleton.centres, subject.offsets))
    return eqx.tree_at(lambda s: (s.skeleton.centres, s.offsets), subject, (centres, offsets))
