"""Priors for poses near a reference pose, or near rest."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import check_fields, checked
from ...body.body import Posed
from ...body.pose import Pose, local_rotation_vectors
from ...body.retraction import difference
from ...body.skeleton import Skeleton, dof_layout
from ...geometry import rotation
from ...stacking import device_array
from ...value_checks import check_deviations
from ..energy import AbstractEnergy


class PosePrior(AbstractEnergy):
    """`sum_k (d_k / s_k)^2`, where `d` is the tangent from a reference pose to this one and `s (D,)` are
    standard deviations in metres and radians (infinite: free).

    Determines unobserved coordinates, damps a step, or ties a frame to its prediction.
    """

    reference: Pose
    deviations: Float[Array, "D"]

    def __check_init__(self):
        check_fields(self)
        check_deviations("PosePrior", deviations=self.deviations)

    def residual(self, posed: Posed):
        return difference(posed.body.skeleton, self.reference, posed.pose) / self.deviations


class RestPrior(AbstractEnergy):
    """`sum (w / s)^2` over the rotation vectors `w` of joints from rest, each in its joint's own frame
    (twist, flexion, sideways), with standard deviations `s (J, 3)` in radians (infinite: free).

    An elbow that bends sideways costs more than one that flexes.
    """

    deviations: Float[Array, "J 3"]

    def __check_init__(self):
        check_fields(self)
        check_deviations("RestPrior", deviations=self.deviations)

    def residual(self, posed: Posed):
        return (local_rotation_vectors(posed.body.skeleton, posed.pose) / self.deviations).reshape(-1)


class ReferencePrior(AbstractEnergy):
    """`sum (t / m)^2 + sum (w / s)^2` over the translations `t` and rotation vectors `w` of joints from a
    reference pose.

    Each vector is in its joint's own frame as in `RestPrior`, with standard deviations `m (J,)` in metres and
    `s (J, 3)` in radians (infinite: free). An elbow that leaves the reference bends rather than shears.
    """

    reference: Pose
    metres: Float[Array, "J"]
    radians: Float[Array, "J 3"]

    def __check_init__(self):
        check_fields(self)
        check_deviations("ReferencePrior", metres=self.metres, radians=self.radians)

    def residual(self, posed: Posed):
        reference, pose = self.reference, posed.pose
        shifts = pose.translations - reference.translations
        turns = rotation.multiply(rotation.conjugate(reference.rotations), pose.rotations)
        vectors = local_rotation_vectors(posed.body.skeleton, Pose(shifts, turns, pose.scale))
        return jnp.concatenate(
            [(shifts / self.metres[:, None]).reshape(-1), (vectors / self.radians).reshape(-1)]
        )


@checked
def tangent_deviations(skeleton: Skeleton, metres: float, radians: float) -> Float[Array, "D"]:
    """Make the standard deviations of a tangent: one for translations, one for rotations."""
    deviations = np.full(skeleton.num_dofs + 1, radians)
    deviations[dof_layout(skeleton).translations] = metres
    return device_array(deviations[:-1], skeleton.centres.dtype)
