"""A skeleton with markers attached to its bones."""

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
from ..small_matrices import apply_small

#: marker models: fixed to a point of its bone; on a circle about the bone; on a sphere about its joint
MARKER_MODELS = ("rigid", "circle", "sphere")
#: default standard deviation of a marker about its position on the bone, metres
DEFAULT_DEVIATION = 0.01
#: standard deviation of a rotation without a prior, radians
FREE_DEVIATION = 100.0


class Subject(eqx.Module):
    """A skeleton and M markers on its bones. The rest pose has the bone lengths of the subject.

    `offsets` are the marker positions in the world with the skeleton at rest, as in `BoneLandmarks.rest`. A
    "circle" marker keeps its distance from the bone and its position along the bone. A "sphere" marker keeps
    its distance from the joint that moves its bone.
    """

    skeleton: Skeleton
    bones: Int[Array, "M"]
    offsets: Float[Array, "M 3"]
    #: weights of attachment, 0 to 1; a marker with weight 0 is not used
    weights: Float[Array, "M"]
    #: standard deviation of observed about predicted positions, metres along each axis
    deviations: Float[Array, "M"]
    labels: tuple[str, ...] = eqx.field(static=True)
    models: tuple[str, ...] = eqx.field(static=True)
    #: standard deviations of each joint from rest about the axes of its own frame (twist, flexion, sideways),
    #: radians, as of `RestPrior`; None: all poses are equally probable
    posture: Float[Array, "J 3"] | None = None

    def __check_init__(self):
        lengths = check_fields(self)
        for name in ("labels", "models"):
            check_length(self, name, len(getattr(self, name)), lengths, "M")

    @property
    def num_markers(self) -> int:
        """The number of markers, M."""
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
    posture=None,
) -> Subject:
    """Build a `Subject` and check its fields.

    **Arguments:** `bones (M,)` joint indices; `offsets (M, 3)` rest positions in the world, metres;
    `labels`, all different; `weights (M,)` of attachment from 0 to 1, by default 1; `deviations (M,)`
    metres, by default 0.01; `models` out of `MARKER_MODELS`, by default "rigid"; `posture (J, 3)`, standard
    deviations of the joints from rest, radians, by default none.

    **Raises:** `ValueError` with one sentence that names the marker.
    """
    count, dtype, labels = len(labels), skeleton.centres.dtype, tuple(labels)
    bones, offsets = np.asarray(bones), np.asarray(offsets, float)
    weights = np.ones(count) if weights is None else np.asarray(weights, float)
    deviations = np.full(count, DEFAULT_DEVIATION) if deviations is None else np.asarray(deviations, float)
    models = ("rigid",) * count if models is None else tuple(models)
    shapes = bones.shape[:1], offsets.shape[:1], weights.shape, deviations.shape, (len(models),)
    if offsets.shape != (count, 3) or any(shape != (count,) for shape in shapes):
        raise ValueError(
            f"There are {count} labels, bones of shape {bones.shape}, offsets {offsets.shape}, weights "
            f"{weights.shape}, deviations {deviations.shape} and {len(models)} models; give one of each for "
            "every marker."
        )
    for marker, label in enumerate(labels):
        if labels.count(label) > 1:
            raise ValueError(f"The marker label '{label}' occurs twice; give every marker its own label.")
        if not 0 <= bones[marker] < skeleton.num_joints:
            raise ValueError(
                f"Marker '{label}' is on bone {bones[marker]}; expected 0 to {skeleton.num_joints - 1}."
            )
        if models[marker] not in MARKER_MODELS:
            raise ValueError(
                f"Marker '{label}' has the model '{models[marker]}'; expected one of {', '.join(MARKER_MODELS)}."
            )
        if not np.isfinite(offsets[marker]).all():
            raise ValueError(f"The offset of marker '{label}' is not finite; give its rest position.")
        if not 0 <= weights[marker] <= 1 or not 0 < deviations[marker] < np.inf:
            raise ValueError(
                f"Marker '{label}' has the weight {weights[marker]} and the deviation {deviations[marker]}; "
                "expected a weight from 0 to 1 and a deviation above 0 metres."
            )
    offsets, weights, deviations = (jnp.asarray(values, dtype) for values in (offsets, weights, deviations))
    usual = None if posture is None else jnp.asarray(posture, dtype)
    return Subject(
        skeleton, jnp.asarray(bones, jnp.int32), offsets, weights, deviations, labels, models, usual
    )


@checked
def marker_positions(subject: Subject, pose: Pose) -> Float[Array, "M 3"]:
    """Compute the marker positions of a pose, metres; circle and sphere markers as if rigid."""
    transforms = forward_kinematics(subject.skeleton, pose)
    r, t = transforms.rotations[subject.bones], transforms.translations[subject.bones]
    return apply_small(r, subject.offsets) + t


@checked
def marker_body(subject: Subject) -> Body:
    """Build the body for user-defined terms: the subject's skeleton, with markers as vertices.

    It has no faces.
    """
    weights = jax.nn.one_hot(subject.bones, subject.skeleton.num_joints, dtype=subject.offsets.dtype)
    return Body(subject.skeleton, LinearSkin(weights), subject.offsets, jnp.zeros((0, 3), jnp.int32))


def shift_markers(subject: Subject, shifts: Float[Array, "M 3"]) -> Subject:
    """Shift the rest positions of the markers, metres."""
    return eqx.tree_at(lambda s: s.offsets, subject, subject.offsets + shifts)
