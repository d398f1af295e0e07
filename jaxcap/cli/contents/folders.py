"""Text descriptions of a folder, a pattern or a sequence of clouds."""

from collections import Counter
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...io.archives.npz import load_motion
from ...io.cameras import read_cameras
from ...io.kinds import KIND_NAMES, KIND_PLURALS, identify
from ...io.meshes.clouds import Scans, read_clouds
from ...io.meshes.mesh import SUFFIXES
from ...io.skeletons.rig_files import find_rig_files
from ..console.console import pluralise, say
from ..scan.depth_images import image_path
from .bodies import describe_motion, describe_scan_unit, format_size
from .depth import NOBODY, NOT_METRES, DepthOptions, describe_camera_depth, describe_depth
from .listing import Contents
from .texts import describe_journal, describe_statistics

#: maximum number of files of a folder that are identified
MAX_IDENTIFIED = 1000


def describe_folder(folder: Path, unit: str | None, options: DepthOptions) -> Contents:
    """Print a description of a folder, and return its contents. Raises `InputError` if no verb can read any file
    in it."""
    kind = identify(folder)
    if kind == "run":
        return Contents(_run(folder))
    found = _kinds(folder)
    there = Counter(found.values())
    if kind == "scans":
        cameras = read_cameras(folder / "cameras.json")
        say(f"scans of {pluralise(len(cameras), 'camera')}")
        images = [image_path(folder, number, 0).parent for number in range(len(cameras))]
        if any(one.is_dir() for one in images):
            options = options._replace(cameras=folder / "cameras.json")
            found = [describe_depth(one, options, number) for number, one in enumerate(images)]
            shown = next((one for one in found if one.kind != NOBODY), found[0])
            return shown if shown.kind in (NOBODY, NOT_METRES) else shown._replace(kind="depth scans")
        return describe_clouds(str(folder), unit, "scans")
    if there["mesh"]:
        return describe_clouds(str(folder), unit)
    if not there:
        raise InputError(
            f"{folder}: this folder has no file that a verb reads; `jaxcap demo -o {folder}/demo` makes an "
            "example."
        )
    # with cameras, pictures are refused as depth images
    if there["depth"] + (options.cameras is not None) * there["picture"] == sum(there.values()):
        return describe_camera_depth(folder, options)
    for one, count in there.most_common():
        say(KIND_NAMES[one] if count == 1 else f"{count} {KIND_PLURALS[one]}")
    return Contents(f"folder of {there.most_common(1)[0][0]}")


def describe_clouds(source: str, unit: str | None, kind: str = "clouds") -> Contents:
    """Print the number of clouds; meshes with the same triangles are registered ones."""
    scans = read_clouds(source, unit=unit or "m")
    first = scans[0]
    size = np.ptp(first.points, axis=0)
    if kind == "clouds" and _is_registered(scans):
        say(
            f"registered meshes: {len(scans)} with {len(first.points)} vertices and {len(first.faces)} triangles; size of the first "
            f"{format_size(size)}"
        )
        return Contents("meshes", describe_scan_unit(size, unit))
    normals = "with" if first.normals is not None else "without"
    say(
        f"clouds: {pluralise(len(scans), 'frame')}; the first has {pluralise(len(first.points), 'point')} {normals} normals, "
        f"{format_size(size)}"
    )
    return Contents(kind, describe_scan_unit(size, unit))


def _is_registered(scans: Scans) -> bool:
    """Check if the first, the middle and the last frame have the same triangles and number of vertices."""
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
        describe_motion(load_motion(folder / "motion.npz"))
    if (folder / "statistics.json").is_file():
        describe_statistics(folder / "statistics.json")
    if not (folder / "journal").is_file():
        return "run"
    describe_journal(folder / "journal")
    return "run" if (folder / "motion.npz").is_file() else "unfinished"


def first_file_of_kind(folder: Path, kind: str) -> Path | None:
    """Return the first file of a kind in a folder."""
    return next((path for path, one in _kinds(folder).items() if one == kind), None)


def _kinds(folder: Path) -> dict[Path, str]:
    """Identify the first files of a folder; skeleton files of a mesh count as part of its body."""
    files = [path for path in sorted(folder.iterdir())[:MAX_IDENTIFIED] if path.is_file()]
    kinds = {path: kind for path in files if (kind := _kind(path)) is not None}
    rig_files = {
        path for mesh, kind in kinds.items() if kind == "rigged" for path in find_rig_files(mesh) or ()
    }
    return {path: kind for path, kind in kinds.items() if path not in rig_files}


def _kind(path: Path) -> str | None:
    """Identify a file of a folder, meshes by suffix only, as a folder may have thousands."""
    if path.suffix.lower() in SUFFIXES:
        return "rigged" if find_rig_files(path) else "mesh"
    return identify(path)
