"""A person while one body is learned from several people."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body
from ...body.pose import Pose, take_poses
from ..skeleton.given_centres import GivenCentres

#: numbers of meshes for which functions are compiled
LENGTHS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)


class Person(NamedTuple):
    """The shared body in the shape of one person, with the person's meshes and their poses."""

    body: Body
    poses: Pose
    targets: Float[Array, "F V 3"]
    #: where the surface has the joints
    given: GivenCentres
    damping: float
    #: Q of this person's meshes, squared metres
    value: float = np.inf
    #: one for the meshes of the person, and zero for repeated ones (`repeat_meshes`), which follow; None without repeated ones
    frame_weights: Float[Array, "F"] | None = None

    @property
    def num_meshes(self) -> int:
        """The number of meshes without repeated ones."""
        return len(self.targets) if self.frame_weights is None else int(np.sum(self.frame_weights))


def repeat_meshes(person: Person) -> Person:
    """Append the first meshes of a person, with weight zero, until their number is one of `LENGTHS`.

    Functions are compiled for each number of meshes.
    """
    count = len(person.targets)
    rows = repeated_rows(count)
    return person._replace(
        poses=take_poses(person.poses, rows),
        targets=person.targets[rows],
        frame_weights=jnp.asarray(np.arange(len(rows)) < count, person.targets.dtype),
    )


def repeated_rows(count: int) -> Int[np.ndarray, "F"]:
    """Number the meshes of a person from 0, and again from 0 until there are as many as one of `LENGTHS`."""
    return np.arange(next((length for length in LENGTHS if length >= count), count)) % count
