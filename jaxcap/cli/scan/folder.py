"""The folder of a scanned motion: its files, and the settings of its run."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path

import jax
import numpy as np

from ...errors import InputError
from ...io.meshes.clouds import read_clouds, save_clouds
from ...io.table import write_json
from ...io.text import read_json

#: the settings of the scans
HEADER = "scan.json"
CLOUDS = "clouds.npz"
FILES = (HEADER, "cameras.json", "truth.npz", CLOUDS)
_SCAN, _IMAGES = re.compile(r"scan_\d{4,}\.ply$"), re.compile(r"(depth|mask)\d+$")


def frame_path(folder: Path, frame: int) -> Path:
    """Return the path of the scan of a frame."""
    return folder / f"scan_{frame:04d}.ply"


def prepare_folder(
    folder: Path, settings: Mapping[str, object], inputs: tuple, resume: bool, overwrite: bool
) -> None:
    """Prepare a folder for scans with `settings` of `inputs`, of which the arrays are compared.

    **Raises:** `InputError` if it contains scans without permission to resume or replace them, or scans with
    other settings or inputs.
    """
    header = {**settings, **fingerprint(inputs)}
    scans = [path for path in folder.iterdir() if _SCAN.match(path.name)]
    images = [path for path in folder.iterdir() if _IMAGES.match(path.name) and path.is_dir()]
    scans += [path for one in images for path in one.glob("*.png")]
    there = [*scans, *(folder / name for name in FILES if (folder / name).exists())]
    if there and not (resume or overwrite):
        raise InputError(
            f"{folder}: this folder contains scans; give --resume to continue or --overwrite to replace them."
        )
    if resume and there:
        check_same_scans(folder / HEADER, header)
    for path in there if overwrite else ():
        path.unlink()
    write_json(folder / HEADER, header)


def fingerprint(inputs: tuple) -> dict[str, str]:
    """Compute hashes of body, motion and cameras."""
    found = {}
    for name, part in zip(("body", "motion", "cameras"), inputs, strict=True):
        digest = hashlib.sha256()
        for leaf in jax.tree.leaves(part):
            digest.update(np.asarray(leaf).tobytes())
        found[f"{name} arrays"] = digest.hexdigest()
    return found


def gather_clouds(folder: Path, count: int) -> None:
    """Write all scans of a folder as one `.npz`."""
    save_clouds(folder / CLOUDS, list(read_clouds([frame_path(folder, frame) for frame in range(count)])))


def check_same_scans(path: Path, header: Mapping[str, object]) -> None:
    """Check that scans were made with the settings of a header. Raises `InputError` that names the first
    difference."""
    if not path.is_file():
        raise InputError(
            f"{path}: this file with the settings of the scans is missing; give --overwrite to begin anew."
        )
    earlier = read_json(path)
    if not isinstance(earlier, dict):
        raise InputError(f"{path}: this file is damaged; give --overwrite to begin anew.")
    # converted by JSON, so that tuples compare equal to lists
    now = json.loads(json.dumps(header))
    changed = [name for name in now if name not in earlier or earlier[name] != now[name]]
    if changed:
        raise InputError(
            f"{path}: the scans were made with another '{changed[0].replace('_', '-')}'; give the same, or "
            "--overwrite to begin anew."
        )
