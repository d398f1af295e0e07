"""The interface of skins; each skinning method is one final class."""

import abc

import equinox as eqx
from jaxtyping import Array, Float, Int

from ...arguments import check_fields
from ..geometric_jacobian import GeometricJacobian
from ..kinematics import Transforms
from ..pose import Pose
from ..skeleton import Skeleton
from .interpolate import AnyArray


class AbstractSkin(eqx.Module):
    """Binds every vertex of a body to its bones.

    A skin deforms the vertices (`deform`), assigns each to one bone (`dominant_bones`), gives the weight of each
    bone (`bone_weights`), and differentiates by unknown parameters (`jacobian`). It also makes the skin of a
    subset of the vertices (`take`), of other points on the same surface (`transfer`), and of the same body in another size
    (`scaled`).
    """

    def __check_init__(self):
        check_fields(self)

    @abc.abstractmethod
    def deform(
        self, vertices: Float[Array, "V 3"], skeleton: Skeleton, pose: Pose, transforms: Transforms
    ) -> Float[Array, "V 3"]:
        """Compute posed positions `(V, 3)` of the rest `vertices (V, 3)`, metres.

        `transforms` are those of the `pose`: `forward_kinematics(skeleton, pose)`.
        """

    @abc.abstractmethod
    def dominant_bones(self) -> Int[Array, "V"]:
        """Return the bone of each vertex."""

    @abc.abstractmethod
    def bone_weights(self, num_bones: int) -> Float[Array, "V J"]:
        """Return the share of each bone in the motion of each vertex; rows sum to one."""

    @abc.abstractmethod
    def take(self, vertices: Int[Array, "C"]) -> "AbstractSkin":
        """Select the skin of chosen vertices, in their order."""

    @abc.abstractmethod
    def transfer(
        self, corners: Int[AnyArray, "N 3"], barycentric: Float[AnyArray, "N 3"], skeleton: Skeleton
    ) -> "AbstractSkin":
        """Interpolate the skin at points on the surface, each in a triangle of three vertices.

        **Arguments:** `corners` are the vertices of the triangles, `barycentric` the barycentric coordinates of
        the points; negative ones count as zero.
        """

    @abc.abstractmethod
    def scaled(self, factor: Float[Array, ""]) -> "AbstractSkin":
        """Return the skin of the body scaled by a factor; the same one unless it has lengths."""

    @abc.abstractmethod
    def jacobian(
        self,
        vertices: Float[Array, "V 3"],
        directions: Float[Array, "V R 3"],
        skeleton: Skeleton,
        pose: Pose,
        transforms: Transforms,
        rates: GeometricJacobian,
    ) -> Float[Array, "V R N"]:
        """Differentiate `deform` along `directions (V, R, 3)` of each posed vertex by the N parameters of
        `rates`: `n . dx_v / dk`.

        `vertices (V, 3)` are those of the whole skin, at rest; `take` reduces it first.
        """
