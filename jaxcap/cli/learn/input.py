"""Options of `jaxcap learn` as arrays: held-out meshes, and pairs of joints."""

from pathlib import Path

import numpy as np

from ...body.skeleton import Skeleton
from ...errors import InputError
from ...io.archives.journal import hash_file
from ...io.skinned.clip import split_clip
from ..sources import is_human_spec


def skeleton_digest(spec: Path) -> str:
    """Return an identifier of a skeleton: the hash of its file, or the options of `human`."""
    if is_human_spec(str(spec)):
        return str(spec)
    return hash_file(split_clip(spec)[0])


def split_held_out(count: int, hold_out: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Split mesh indices into training and held-out: every `hold_out`-th is held out."""
    numbers = np.arange(count)
    held = np.zeros(count, bool) if hold_out is None else numbers % hold_out == hold_out - 1
    return numbers[~held], numbers[held]


def read_pairs(text: str, skeleton: Skeleton | None) -> np.ndarray:
    """Parse `left:right,...` to (P, 2) joints, by number or by name of a given skeleton. Raises
    `InputError`."""
    rows = []
    for word in text.split(","):
        sides = [side.strip() for side in word.split(":")]
        if len(sides) != 2 or not all(sides):
            raise InputError(f"--pairs has '{word}'; it must be left:right, such as 3:5,4:6.")
        row = []
        for side in sides:
            # names of learned joints have this prefix
            number = side.removeprefix("joint") if skeleton is None else side
            if skeleton is not None and side in skeleton.names:
                row.append(skeleton.names.index(side))
            elif number.isdigit() and (skeleton is None or int(number) < skeleton.num_joints):
                row.append(int(number))
            else:
                there = "" if skeleton is None else f"; the skeleton has {', '.join(skeleton.names)}"
                raise InputError(f"--pairs has '{side}', which is not a joint{there}.")
        if row[0] == row[1]:
            raise InputError(f"--pairs has '{word}', which pairs a joint with itself.")
        rows.append(row)
    return np.array(rows)
