"""Limbs that are inside of other parts of the body."""

from collections.abc import Collection

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import check_fields, checked
from ...body.body import Body, Posed, pose_body
from ...body.geometric_jacobian import wrenches_of
from ...body.people.anatomy import BODY_REGIONS
from ...body.pose import rest_pose
from ...body.skeleton import Skeleton
from ...geometry.sampling import even_indices
from ...small_matrices import apply_small
from ..data.bones import AbstractBoneEnergy
from ..data.soft_object import SoftObject, make_soft_object, soft_distance, soft_distance_slopes
from ..energy import safe_sqrt

#: parts of a person's limbs that must not be inside of others, without their side
ARM = ("ForeArm", "Hand", "FingerBase", "HandFinger1")
LEG = ("Leg", "Foot", "ToeBase")
TRUNK = (*BODY_REGIONS["trunk"], *BODY_REGIONS["head"])
#: number of points of a limb, and depth that is allowed everywhere, as skin is soft, metres
NUM_POINTS, ALLOWED_DEPTH = 48, 0.01


class LimbCollision(eqx.Module):
    """Points of a limb, and the parts that they must not be inside of."""

    others: SoftObject
    #: at rest, metres, and the bones that move them
    points: Float[Array, "N 3"]
    bones: Int[Array, "N"]
    #: depth in the others that is allowed, metres: more where the limb is inside of them at rest
    allowed: Float[Array, "N"]


class SelfCollision(AbstractBoneEnergy):
    """`sum_i w_i max(depth_i - allowed_i, 0)^2` over points of limbs inside of other parts of the body.

    Parts are soft objects (`SoftObject`), and points move rigidly with their bones.
    """

    limbs: tuple[LimbCollision, ...]
    #: weight of a point, per metre squared
    weight: Float[Array, ""]

    def __check_init__(self):
        check_fields(self)

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        depths = []
        for limb in self.limbs:
            depth = -soft_distance(limb.others, posed, _limb_points(limb, posed))
            depths.append(jnp.maximum(depth - limb.allowed * posed.pose.scale, 0.0))
        return safe_sqrt(self.weight) * jnp.concatenate(depths)

    def bone_jacobian(self, posed: Posed):
        """Differentiate by all bones.

        A distance depends on the place of a point relative to a primitive only, so a motion of the primitive's bone acts as the
        opposite motion of the point.
        """
        rows, bones = [], jnp.arange(len(posed.joints))
        for limb in self.limbs:
            points = _limb_points(limb, posed)
            distance, slopes = soft_distance_slopes(limb.others, posed, points)
            inside = -distance - limb.allowed * posed.pose.scale > 0
            wrenches = wrenches_of(points, slopes)
            wrenches = jnp.where(inside[:, None, None], safe_sqrt(self.weight) * wrenches, 0.0)
            # products with membership matrices are faster on a CPU than scatters
            of_others = (limb.others.bones[:, None] == bones).astype(slopes.dtype)
            own = (limb.bones[:, None] == bones).astype(slopes.dtype)
            moved = jnp.einsum("npc,pj->njc", wrenches, of_others)
            rows.append(moved - own[:, :, None] * jnp.sum(wrenches, 1)[:, None])
        return None, jnp.concatenate(rows)[:, :, None]


@checked
def make_self_collision(body: Body, deviation: float | int = 0.01) -> SelfCollision | None:
    """Make the self-collision energy of a person's arms and lower legs.

    Arms must not be inside of the trunk, the thighs and each other, and lower legs not inside of the other leg.

    None if the joints do not have the names of the embedded human. **Arguments:** `deviation`, the standard deviation of
    a depth, metres.
    """
    skeleton = body.skeleton
    if not {"LeftForeArm", "RightForeArm", "LeftLeg", "RightLeg", "Spine"} <= set(skeleton.names):
        return None
    whole, limbs = make_soft_object(body), []
    for side, other in (("Left", "Right"), ("Right", "Left")):
        far = [f"{other}{name}" for name in ("Arm", *ARM)]
        thighs = ["LeftUpLeg", "RightUpLeg"]
        limbs.append(
            _limb(body, whole, _bones(skeleton, ARM, side), _bones(skeleton, [*TRUNK, *far, *thighs]))
        )
        near = _bones(skeleton, ("UpLeg", *LEG), other)
        limbs.append(_limb(body, whole, _bones(skeleton, LEG, side), near))
    return SelfCollision(tuple(limbs), jnp.asarray(deviation**-2, body.vertices.dtype))


def _limb_points(limb: LimbCollision, posed: Posed) -> Float[Array, "N 3"]:
    r, t = posed.transforms.rotations[limb.bones], posed.transforms.translations[limb.bones]
    return apply_small(r, limb.points) + t


def _bones(skeleton: Skeleton, names: Collection[str], side: str = "") -> list[int]:
    return [skeleton.index(side + name) for name in names if side + name in skeleton.names]


def _limb(body: Body, whole: SoftObject, own: list[int], others: list[int]) -> LimbCollision:
    bones = np.asarray(body.skin.dominant_bones())
    rows = np.flatnonzero(np.isin(bones, own))
    rows = rows[even_indices(len(rows), NUM_POINTS)]
    kept = np.flatnonzero(np.isin(np.asarray(whole.bones), others))
    parts = SoftObject(whole.bones[kept], whole.centres[kept], whole.precisions[kept], whole.stiffness)
    points, skeleton = body.vertices[rows], body.skeleton
    depth = -soft_distance(parts, pose_body(body, rest_pose(skeleton)), points)
    allowed = jnp.maximum(depth, 0.0) + ALLOWED_DEPTH
    return LimbCollision(parts, points, jnp.asarray(bones[rows]), allowed)
