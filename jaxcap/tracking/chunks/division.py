"""The division of a sequence into chunks."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...errors import InputError

#: usual number of chunks, and least and largest usual number of frames in one: each chunk costs frames that are tracked twice
NUM_CHUNKS, MIN_FRAMES, MAX_FRAMES = 8, 200, 500
#: number of frames before a chunk in which the pose before its first frame is found
WARM_UP = 8


class Chunk(NamedTuple):
    """A part of a sequence: the numbers of its first frame and of the one after its last frame."""

    begin: int
    end: int


def count_chunks(num_frames: int) -> int:
    """Choose the number of chunks of a sequence.

    It does not depend on the number of workers, and so neither do the poses.
    """
    return max(round(num_frames / min(max(num_frames / NUM_CHUNKS, MIN_FRAMES), MAX_FRAMES)), 1)


def divide_frames(num_frames: int, num_chunks: int, first: int = 0) -> list[Chunk]:
    """Divide the frames from `first` on into chunks of nearly equal lengths.

    **Raises:** `InputError` if a chunk would have fewer than `WARM_UP` frames.
    """
    if num_chunks < 1:
        raise InputError(f"The number of chunks is {num_chunks}; it must be at least 1.")
    if num_chunks > 1 and num_frames < WARM_UP * num_chunks:
        raise InputError(
            f"{num_frames} frames were to be divided into {num_chunks} chunks; each chunk needs at least {WARM_UP} frames: give fewer "
            "chunks."
        )
    bounds = first + np.linspace(0, num_frames, num_chunks + 1).round().astype(int)
    return [Chunk(int(begin), int(end)) for begin, end in pairwise(bounds)]


def name_ranges(frames: Sequence[tuple[int, int]]) -> str:
    """Name ranges of frames, each by its first one and the one after its last one, such as "3 to 8, 12"."""
    return ", ".join(str(first) if end - first == 1 else f"{first} to {end - 1}" for first, end in frames)
