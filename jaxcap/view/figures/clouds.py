"""Scans for display: read on first use, subsampled for a browser, and cached."""

import threading
from collections import OrderedDict
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...io.meshes.clouds import Scans

#: maximum number of drawn points of a scan; more cannot be distinguished on a screen
MAX_POINTS = 20_000
#: size of the cache of scans, bytes
CACHE_BYTES = 128 * 2**20


class DisplayCloud(NamedTuple):
    """The points of one scan, metres, with normals if the file has them."""

    name: str
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"] | None


class DisplayClouds:
    """The scans of a sequence, shared by several windows.

    **Arguments:** `scans`; `upright_rotation (3, 3)`, the rotation to upright; `max_points`, the largest
    number of points of each scan, sampled uniformly over the file's order and so over the surface.
    """

    def __init__(
        self,
        scans: Scans,
        upright_rotation: Float[np.ndarray, "3 3"] | None = None,
        max_points: int = MAX_POINTS,
    ):
        self.scans, self.most = scans, max_points
        self._turn = np.eye(3) if upright_rotation is None else upright_rotation
        self._kept: OrderedDict[int, DisplayCloud] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, frame: int) -> DisplayCloud:
        """Return one scan. Raises `InputError` if its file is invalid, for example while it is still being
        written."""
        with self._lock:
            if frame not in self._kept:
                self._kept[frame] = self._read(frame)
            self._kept.move_to_end(frame)
            while (
                len(self._kept) > 1 and sum(_num_bytes(cloud) for cloud in self._kept.values()) > CACHE_BYTES
            ):
                self._kept.popitem(last=False)
            return self._kept[frame]

    def _read(self, frame: int) -> DisplayCloud:
        scan = self.scans[frame]
        rows = sample_rows(len(scan.points), self.most)
        normals = None if scan.normals is None else scan.normals[rows] @ self._turn.T
        return DisplayCloud(scan.name, scan.points[rows] @ self._turn.T, normals)


def sample_rows(count: int, max_rows: int) -> Int[np.ndarray, "N"]:
    """Sample at most `max_rows` row indices of an array, in order and the same ones for every array of one size.
    The sample is random, as a stride would alias with the rows of a depth image."""
    if count <= max_rows:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, max_rows, replace=False))


def _num_bytes(cloud: DisplayCloud) -> int:
    return cloud.points.nbytes * (1 if cloud.normals is None else 2)
