"""The joints on whose rotations the displacements of each vertex depend."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ...body.body import Body

#: share of a bone in the motion of a vertex above which the bone influences it
MIN_INFLUENCE = 0.02
#: widths of lists of columns are multiples of this, so that similar bodies share compiled functions
WIDTH_STEP = 8


def find_near_joints(body: Body) -> Bool[np.ndarray, "V J"]:
    """Find the joints of the bones that influence each vertex, and the neighbours of these in the tree.

    Fixed joints and roots are left out: they have no rotation of their own that bends the surface.
    """
    parents = np.array(body.skeleton.parents)
    joints = np.arange(len(parents))
    children = parents[:, None] == joints
    neighbours = np.eye(len(parents), dtype=bool) | children | children.T
    influences = np.asarray(body.skin.bone_weights(len(parents))) > MIN_INFLUENCE
    bends = (parents >= 0) & np.array([kind != "fixed" for kind in body.skeleton.kinds])
    return ((influences.astype(int) @ neighbours) > 0) & bends


def list_columns(used: Bool[np.ndarray, "V K"]) -> tuple[Int[Array, "V N"], Bool[Array, "V N"]]:
    """List the columns that each row uses, padded with column 0, and mark those that are not padding."""
    counts = used.sum(1)
    width = WIDTH_STEP * -(-max(int(counts.max(initial=0)), 1) // WIDTH_STEP)
    order = np.argsort(~used, axis=1, kind="stable")[:, :width]
    order = np.pad(order, ((0, 0), (0, width - order.shape[1])))
    marks = np.arange(width) < counts[:, None]
    return jnp.asarray(np.where(marks, order, 0)), jnp.asarray(marks)
