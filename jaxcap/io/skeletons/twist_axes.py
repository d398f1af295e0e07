"""What the skeleton formats share: ends of bones as joints, and twist axes from the tree.

A format that says where the last bone of a chain ends (`End Site` of BVH, the length of a
leaf bone in ASF) is read with a `fixed` joint at that end, named `<bone>.end`. The writers
turn these joints back into what they came from, so that nothing multiplies.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...body.skeleton import Skeleton

#: how the name of a joint at the end of a chain ends
END = ".end"


def is_end(names: tuple[str, ...], parents: tuple[int, ...], kinds: tuple[str, ...], joint: int) -> bool:
    """Whether a joint is the mere end of its parent: `fixed`, a leaf, named `<parent>.end`."""
    parent = parents[joint]
    return (
        parent >= 0
        and kinds[joint] == "fixed"
        and joint not in parents
        and names[joint].startswith(names[parent] + END)
    )


def twist_orientations(centres: np.ndarray, parents: list[int]) -> np.ndarray:
    """(J, 4) quaternions whose x axis points from a joint to the mean of its children; a leaf
    goes on as its parent does. Joints stand parents first."""
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
    # the shortest arc from x, in NumPy: a file should not wait for a compiler
    x, y, z = directions.T
    arcs = np.stack([1.0 + x, 0.0 * x, -z, y], 1)
    arcs[x < -1.0 + 1e-9] = [0.0, 0.0, 0.0, 1.0]
    return arcs / np.linalg.norm(arcs, axis=1, keepdims=True)


def with_twist_axes(skeleton: Skeleton) -> Skeleton:
    """The same skeleton with the orientations of `twist_orientations`."""
    orientations = twist_orientations(np.asarray(skeleton.centres), list(skeleton.parents))
    return eqx.tree_at(lambda s: s.orientations, skeleton, jnp.asarray(orientations, skeleton.centres.dtype))
