"""Linear constraints on joint centres: planes for joints on the middle of the body, and short bones that keep their vectors."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .given_centres import GivenCentres


class MiddlePlanes(eqx.Module):
    """Planes in which the centres of joints on the middle of the body stay."""

    normals: Float[Array, "M 3"]
    points: Float[Array, "M 3"]
    joints: tuple[int, ...] = eqx.field(static=True)

    def differences(self, centres: Float[Array, "J 3"]) -> tuple[Float[Array, "M"], Float[Array, "M J 3"]]:
        """Compute the signed distances of centres from their planes, metres, and their derivatives by the centres."""
        joints, rows = np.array(self.joints, int), np.arange(len(self.joints))
        slopes = jnp.zeros((len(rows), *centres.shape), centres.dtype).at[rows, joints].set(self.normals)
        return jnp.sum((centres[joints] - self.points) * self.normals, 1), slopes


class KeptBones(eqx.Module):
    """Vectors from the centres of joints to those of other joints, which stay as they are."""

    vectors: Float[Array, "P 3"]
    #: pairs of a joint and the one to which the vector leads
    pairs: tuple[tuple[int, int], ...] = eqx.field(static=True)

    def differences(self, centres: Float[Array, "J 3"]) -> tuple[Float[Array, "C"], Float[Array, "C J 3"]]:
        """Compute the differences of the current vectors, flattened, metres, and their derivatives by the centres."""
        starts, ends = np.array(self.pairs, int).reshape(-1, 2).T
        rows = np.arange(len(starts))
        slopes = jnp.zeros((len(rows), 3, *centres.shape), centres.dtype)
        for axis in range(3):
            slopes = slopes.at[rows, axis, ends, axis].set(1.0).at[rows, axis, starts, axis].set(-1.0)
        gaps = centres[ends] - centres[starts] - self.vectors
        return gaps.ravel(), slopes.reshape(-1, *centres.shape)


def middle_planes(given: GivenCentres) -> MiddlePlanes | None:
    """Build the planes of the joints on the middle; None if there are none."""
    if given.normals is None:
        return None
    joints = np.flatnonzero(np.asarray(given.normals).any(1))
    return MiddlePlanes(given.normals[joints], given.centres[joints], tuple(joints.tolist()))


def kept_bones(
    given: GivenCentres, close: tuple[tuple[int, int], ...], left_right_pairs: Int[np.ndarray, "P 2"]
) -> KeptBones | None:
    """Keep the given vectors between pairs of joints that are close to each other; None without pairs.

    Vectors that lead to two joints of `left_right_pairs` get their mean length.
    """
    if not close:
        return None
    starts, ends = np.array(close, int).T
    vectors = given.centres[ends] - given.centres[starts]
    lengths = jnp.linalg.norm(vectors, axis=1)
    rows = {int(joint): row for row, joint in enumerate(ends)}
    other = {int(a): int(b) for pair in left_right_pairs for a, b in (pair, pair[::-1])}
    partners = np.array([rows.get(other.get(int(joint), -1), row) for joint, row in rows.items()], int)
    equal = 0.5 * (lengths + lengths[partners])
    return KeptBones(vectors * (equal / jnp.maximum(lengths, 1e-12))[:, None], close)
