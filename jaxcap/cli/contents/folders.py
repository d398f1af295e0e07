"""What a folder, a pattern or a sequence of clouds holds, in lines of text."""

from collections import Counter
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.cameras import read_cameras
from ...io.clouds import Scans, read_clouds
from ...io.kinds import WORDS, identify
from ...io.mesh import SUFFIXES
from ...io.npz import load_motion
from ..say import say
from .bodies import metres, tell_motion
from .texts import tell_journal, tell_statistics

#: files of a folder that are looked at one by one
LOOKED_AT = 1000


def tell_folder(folder: Path, unit: str) -> str:
    """Say what a folder holds, and return its kind. Raises `InputError` where there is nothing that a verb reads."""
    kind = identify(folder)
    if kind == "run":
        return _run(folder)
    kinds = (_kind(path) for path in sorted(folder.iterdir())[:LOOKED_AT] if path.is_file())
    there = Counter(one for one in kinds if one is not None)
    if kind == "scans":
        cameras = read_cameras(folder / "cameras.json")
        say(f"scans of {len(cameras)} cameras")
        return tell_clouds(str(folder), unit, "scans")
    if there["mesh"]:
        return tell_clouds(str(folder), unit)
    if not there:
        raise InputError(
            f"{folder}: there is nothing in this folder that a verb reads; `jaxcap demo -o {folder}/demo` makes something."
        )
    for one, count in there.most_common():
        say(f"{count} of {WORDS[one]}")
    first = there.most_common(1)[0][0]
    return f"folder of {first}"


def tell_clouds(source: str, unit: str, kind: str = "clouds") -> str:
    """Say how many clouds there are; meshes of the same triangles are registered ones."""
    scans = read_clouds(source, unit=unit)
    first = scans[0]
    if kind == "clouds" and _registered(scans):
        say(
            f"registered meshes: {len(scans)} of {len(first.points)} vertices and {len(first.faces)} triangles, the first "
            f"{metres(np.ptp(first.points, axis=0))}"
        )
        return "meshes"
    normals = "with" if first.normals is not None else "without"
    say(
        f"clouds: {len(scans)} frames; the first has {len(first.points)} points {normals} normals, "
        f"{metres(np.ptp(first.points, axis=0))}"
    )
    return kind


def _registered(scans: Scans) -> bool:
    """Whether the first, the middle and the last frame have the same triangles, of as many vertices."""
    if len(scans) < 2 or not len(scans[0].faces):
        return False
    first = scans[0]
    others = [scans[frame] for frame in sorted({1, len(scans) // 2, len(scans) - 1})]
    return all(
        len(other.points) == len(first.points) and np.array_equal(other.faces, first.faces)
        for other in others
    )


def _run(folder: Path) -> str:
    if (folder / "motion.npz").is_file():
        tell_motion(load_motion(folder / "motion.npz"))
    if (folder / "statistics.json").is_file():
        tell_statistics(folder / "statistics.json")
    if not (folder / "journal").is_file():
        return "run"
    tell_journal(folder / "journal")
    return "run" if (folder / "motion.npz").is_file() else "unfinished"


def _kind(path: Path) -> str | None:
    """What a file of a folder is by its suffix, as a folder may have thousands."""
    return "mesh" if path.suffix.lower() in SUFFIXES else identify(path)
