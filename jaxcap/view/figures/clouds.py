"""Scans to look at: read when they are first seen, thinned to what a browser draws, and a few kept."""

import threading
from collections import OrderedDict
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...io.meshes.clouds import Scans

#: points of a scan that are drawn; more are not told apart on a screen
MOST = 20_000
#: bytes of scans that are kept
KEPT = 128 * 2**20


class SeenCloud(NamedTuple):
    """Points of one scan, metres, with their normals where the file has them."""

    name: str
    points: Float[np.ndarray, "N 3"]
    normals: Float[np.ndarray, "N 3"] | None


class SeenClouds:
    """The scans of a sequence, for several windows at once.

    **Arguments:** `scans`; `turn (3, 3)`, what brings them upright; `most` points of each, evenly over
    the file's order and so over the surface.
    """

    def __init__(self, scans: Scans, turn: Float[np.ndarray, "3 3"] | None = None, most: int = MOST):
        self.scans, self.most = scans, most
        self._turn = np.eye(3) if turn is None else turn
        self._kept: OrderedDict[int, SeenCloud] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self.scans)

    def __getitem__(self, frame: int) -> SeenCloud:
        """One scan. Raises `InputError` where its file is wrong, as one that is still being written may be."""
        with self._lock:
            if frame not in self._kept:
                self._kept[frame] = self._read(frame)
            self._kept.move_to_end(frame)
            while len(self._kept) > 1 and sum(_size(cloud) for cloud in self._kept.values()) > KEPT:
                self._kept.popitem(last=False)
            return self._kept[frame]

    def _read(self, frame: int) -> SeenCloud:
        scan = self.scans[frame]
        rows = some_rows(len(scan.points), self.most)
        normals = None if scan.normals is None else scan.normals[rows] @ self._turn.T
        return SeenCloud(scan.name, scan.points[rows] @ self._turn.T, normals)


def some_rows(count: int, most: int) -> Int[np.ndarray, "N"]:
    """At most so many of the rows of an array, in order and the same ones for every array of a size. They are drawn by
    chance, as a stride would alias with the rows of a depth picture."""
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


def _size(cloud: SeenCloud) -> int:
    return cloud.points.nbytes * (1 if cloud.normals is None else 2)
