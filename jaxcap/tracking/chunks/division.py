"""The division of a sequence into chunks that overlap."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...errors import InputError

#: number of successive frames in which two chunks have to agree
AGREEING_FRAMES = 5
#: number of frames that a chunk begins earlier than the frames that it contributes
OVERLAP = 60
#: number of chunks for each worker in a long sequence, so that no worker waits long for another one
CHUNKS_OF_WORKER = 4
#: least length of a chunk in overlaps: of many chunks, and of as many chunks as there are workers
LONG, SHORT = 10, 2


class Chunk(NamedTuple):
    """A part of a sequence, by numbers of frames."""

    #: the first tracked frame
    first: int
    #: the first frame of the result; those before it overlap with the chunk before
    begin: int
    #: the frame after the last one
    end: int


def count_chunks(num_frames: int, workers: int, overlap: int = OVERLAP) -> int:
    """Choose the number of chunks of a sequence: at most a tenth of their frames are tracked twice, unless workers would have none.

    One worker has one chunk.
    """
    if workers == 1:
        return 1
    many = min(CHUNKS_OF_WORKER * workers, num_frames // (LONG * overlap))
    few = min(workers, num_frames // (SHORT * overlap))
    return max(many, few, 1)


def divide_frames(num_frames: int, num_chunks: int, overlap: int = OVERLAP, first: int = 0) -> list[Chunk]:
    """Divide the frames from `first` on into chunks of nearly equal lengths, of which each begins `overlap` frames early.

    **Raises:** `InputError` if a chunk would be shorter than the overlap, or the overlap is too short to compare chunks.
    """
    check_overlap(overlap)
    if num_chunks < 1:
        raise InputError(f"The number of chunks is {num_chunks}; it must be at least 1.")
    if num_chunks > 1 and num_frames < num_chunks * overlap:
        raise InputError(
            f"{num_frames} frames were to be divided into {num_chunks} chunks with an overlap of {overlap} frames; each chunk "
            "needs at least as many frames as the overlap: give fewer chunks or a shorter overlap."
        )
    bounds = first + np.linspace(0, num_frames, num_chunks + 1).round().astype(int)
    return [
        Chunk(int(begin) if number == 0 else int(begin) - overlap, int(begin), int(end))
        for number, (begin, end) in enumerate(pairwise(bounds))
    ]


def check_overlap(overlap: int) -> None:
    """Check that an overlap suffices to compare chunks. Raises `InputError`."""
    if overlap <= AGREEING_FRAMES:
        raise InputError(
            f"The overlap of chunks is {overlap} frames; it must be above {AGREEING_FRAMES}, the number of frames in which they "
            "have to agree."
        )


def name_ranges(frames: Sequence[tuple[int, int]]) -> str:
    """Name ranges of frames, each by its first one and the one after its last one, such as "3 to 8, 12"."""
    return ", ".join(str(first) if end - first == 1 else f"{first} to {end - 1}" for first, end in frames)
