"""Layout of a body's vertices by part, for nearest-neighbour search."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...stacking import device_array

#: Vertices in a block; parts have very different sizes, so padding each to the largest would take six times
#: the work.
BLOCK = 32


class PartBlocks(eqx.Module):
    """A body's vertices in blocks of 32, each of one part and compact in space.

    The blocks of part `k` are consecutive: `blocks_of_part[k]` of them, after those of the previous parts. A
    part's last block is padded with one of its vertices. A part without vertices has no block.
    """

    #: vertex in each slot of each block
    slots: Int[Array, "B 32"]
    #: number of blocks of each part
    blocks_of_part: tuple[int, ...] = eqx.field(static=True)

    @property
    def num_parts(self) -> int:
        """K, the number of parts, including those without vertices."""
        return len(self.blocks_of_part)

    @property
    def num_blocks(self) -> int:
        """B, the number of blocks."""
        return sum(self.blocks_of_part)


@checked
def make_part_blocks(
    bones: Int[Array | np.ndarray, "V"],
    num_parts: int,
    vertices: Float[Array | np.ndarray, "W 3"] | None = None,
) -> PartBlocks:
    """Make the blocks of a body with vertex `v` in part `bones[v]`; once, in NumPy.

    **Arguments:** `bones (V,)` in `[0, num_parts)`; `vertices (V, 3)` positions, for example at rest, to make
    blocks compact, which makes the search several times faster.

    **Raises:** `ValueError` where a bone is out of range, there is no vertex, or `vertices` have another
    number.
    """
    bones = np.asarray(bones)
    if bones.size == 0:
        raise ValueError("`bones` is empty; expected at least one vertex.")
    outside = np.flatnonzero((bones < 0) | (bones >= num_parts))
    if outside.size:
        raise ValueError(
            f"Vertex {outside[0]} belongs to bone {bones[outside[0]]}, but there are only bones 0 to "
            f"{num_parts - 1}; set `num_parts` to the number of bones."
        )
    if vertices is not None and np.shape(vertices) != (len(bones), 3):
        raise ValueError(
            f"`vertices` has shape {np.shape(vertices)}; expected ({len(bones)}, 3), a position for each "
            "of `bones`."
        )
    blocks, counts = [], []
    for part in range(num_parts):
        members = np.flatnonzero(bones == part)
        split = [members[i : i + BLOCK] for i in range(0, len(members), BLOCK)]
        if vertices is not None and len(members):
            split = _split(members, np.asarray(vertices))
        counts.append(len(split))
        blocks += [np.pad(block, (0, BLOCK - len(block)), mode="edge") for block in split]
    return PartBlocks(device_array(blocks, np.int32), tuple(counts))


def _split(members: np.ndarray, vertices: np.ndarray) -> list[np.ndarray]:
    """Split a part along its longest side until each piece fits a block (a k-d tree's leaves).

    Splits are at multiples of the block size, so that no more blocks are made than needed.
    """
    if len(members) <= BLOCK:
        return [members]
    positions = vertices[members]
    side = np.argmax(np.ptp(positions, axis=0))
    order = members[np.argsort(positions[:, side], kind="stable")]
    num_blocks = -(-len(members) // BLOCK)
    cut = BLOCK * (num_blocks // 2)
    return _split(order[:cut], vertices) + _split(order[cut:], vertices)
