"""Shared parts of the skeleton formats: ends of bones as joints, and twist axes from the tree.

A format with the end of the last bone of a chain (`End Site` of BVH, the length of a leaf bone in ASF) is
read with a `fixed` joint at that end, named `<bone>.end`. The writers convert these joints back, so that
repeated conversion adds none.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...body.skeleton import Skeleton

#: suffix of the name of a joint at the end of a chain
END_SUFFIX = ".end"


def is_end_joint(
    names: tuple[str, ...], parents: tuple[int, ...], kinds: tuple[str, ...], joint: int
) -> bool:
    """Check that a joint is only the end of its parent: `fixed`, a leaf, named `<parent>.end`."""
    parent = parents[joint]
    return (
        parent >= 0
        and kinds[joint] == "fixed"
        and joint not in parents
        and names[joint].startswith(names[parent] + END_SUFFIX)
    )


def twist_orientations(centres: np.ndarray, parents: list[int]) -> np.ndarray:
    """Compute (J, 4) quaternions with the x axis from a joint to the mean of its children.

    A leaf has the direction of its parent. Joints are in order, parents first.
    """
    centres = np.asarray(centres, float)
    directions = np.tile([1.0, 0.0, 0.0], (len(parents), 1))
    below: list[list[int]] = [[] for _ in parents]
    for joint, parent in enumerate(parents):
        if parent >= 0:
            below[parent].append(joint)
    for joint, parent in enumerate(parents):
        children = below[joint]
        along = np.mean(centres[children], 0) - centres[joint] if children else np.zeros(3)
        length = np.linalg.norm(along)
        if length > 1e-9:
            directions[joint] = along / length
        elif parent >= 0:
            directions[joint] = directions[parent]
    # the shortest arc from x, in NumPy, as reading a file should not wait for compilation
    x, y, z = directions.T
    arcs = np.stack([1.0 + x, 0.0 * x, -z, y], 1)
    arcs[x < -1.0 + 1e-9] = [0.0, 0.0, 0.0, 1.0]
    return arcs / np.linalg.norm(arcs, axis=1, keepdims=True)


def with_twist_axes(skeleton: Skeleton) -> Skeleton:
    """Return the skeleton with the orientations of `twist_orientations`."""
    orientations = twist_orientations(np.asarray(skeleton.centres), list(skeleton.parents))
    return eqx.tree_at(lambda s: s.orientations, skeleton, jnp.asarray(orientations, skeleton.centres.dtype))
