"""Point clouds without faces: text files of coordinates (.xyz), and the files of PCL (.pcd) by pypcd4."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...depth.check_depths import keep_measured
from ...errors import InputError
from ..system.reader_errors import reader_of

#: the line of a .pcd's header with the number of rows, and the largest size of a header, bytes
_ROWS, _MAX_HEADER = re.compile(rb"^HEIGHT\s+(\d+)\s*$", re.MULTILINE), 4096
#: names of the coordinates of a point, and of its normal, in a .pcd
_POINT, _NORMAL = ("x", "y", "z"), ("normal_x", "normal_y", "normal_z")


def read_xyz(path: Path):
    """Read a line of `x y z`, or `x y z nx ny nz`, for each point; further numbers are ignored.

    Columns are separated by spaces, commas or semicolons; lines that begin with '#' or '//' are comments. Returns points,
    no faces, and the normals or None, as every reader of `read_mesh`. Raises `InputError`, with the line.
    """
    rows = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith(("#", "//")):
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise InputError(
                f"{path}, line {number}: '{line[:40]}' are not numbers; expected x y z."
            ) from None
        if len(rows[-1]) < 3 or len(rows[-1]) != len(rows[0]):
            raise InputError(
                f"{path}, line {number}: there are {len(rows[-1])} numbers; expected {max(len(rows[0]), 3)}, as x y z."
            )
    table = np.array(rows, float).reshape(len(rows), len(rows[0]) if rows else 3)
    # six columns are normals only if they have length one; colours are larger
    lengths = np.linalg.norm(table[:, 3:6], axis=1)
    normals = table[:, 3:6] if table.shape[1] == 6 and np.all(np.abs(lengths - 1) < 1e-2) else None
    return table[:, :3], np.zeros((0, 3), int), normals


def read_pcd(path: Path):
    """Read the measured points of a .pcd; organised clouds have NaN where nothing was measured. Raises `InputError`."""
    table = _load(path)
    points = _columns(table, _POINT)
    if points is None:
        raise InputError(f"{path}: the file has no fields x, y, z, so it has no points.")
    measured = np.isfinite(points).all(1)
    normals = _columns(table, _NORMAL)
    return points[measured], np.zeros((0, 3), int), None if normals is None else normals[measured]


def is_organised(path: Path) -> bool:
    """Test by its header if the points of a .pcd are organised in rows of an image."""
    with open(path, "rb") as file:
        found = _ROWS.search(file.read(_MAX_HEADER))
    return found is not None and int(found[1]) > 1


@reader_of("a PCL point cloud")
def read_organised_depth(path: str | Path) -> Float[np.ndarray, "H W"]:
    """Read the depth image of an organised .pcd, metres along z; zero where nothing was measured.

    **Raises:** `InputError` if the file is no .pcd, or its points are not organised in rows of an image.
    """
    path = Path(path)
    table = _load(path)
    depth = _columns(table, ("z",))
    height, width = table.metadata.height, table.metadata.width
    if depth is None or height < 2:
        raise InputError(
            f"{path}: the points are not organised in rows of an image (HEIGHT 1), so they are no depth image; give the file "
            "as a cloud."
        )
    return keep_measured(depth.reshape(height, width))


def _load(path: Path):
    try:
        from pypcd4.pypcd4 import PointCloud
    except ImportError:
        raise InputError(
            f"{path}: reading .pcd needs the library pypcd4, which is not installed; run pip install -e '.[pcd]' in a "
            "checkout of jaxcap."
        ) from None
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    try:
        return PointCloud.from_path(path)
    except Exception as error:  # a parser of another library: whatever it raises is a fault of the file
        raise InputError(f"{path}: this is no valid .pcd: {str(error).splitlines()[0][:200]}.") from None


def _columns(table, names: tuple[str, ...]) -> Float[np.ndarray, "N K"] | None:
    if not set(names) <= set(table.fields):
        return None
    return np.asarray(table.numpy(list(names)), float)
