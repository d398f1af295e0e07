"""Folders to which another program adds a file for each frame."""

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from ...errors import InputError
from ...observe.clouds import Scan
from ..depth.images import SUFFIXES as IMAGE_SUFFIXES
from ..depth.images import is_depth_image
from ..depth.open_exr import EXR_SUFFIX
from ..depth.sequence import DEPTH_SUFFIXES, DepthFrame, read_depth_file
from ..meshes.clouds import read_clouds
from ..meshes.mesh import SUFFIXES as MESH_SUFFIXES
from ..system.paths import natural_sort_key
from .arrivals import Arrival

#: seconds between two looks into a folder, and for which a file must not change before it is read
POLL_SECONDS, SETTLE_SECONDS = 0.004, 0.03
#: seconds after a change of a folder in which its time of change may miss a file
FOLDER_CLOCK_SECONDS = 0.05
#: seconds after which a file that is still incomplete is read anyway, and refused by its reader
MAX_WAIT_SECONDS = 2.0
#: the same for a file after which another one was completed
OVERTAKEN_WAIT_SECONDS = 0.3
#: files of arrays, which are frames of streams only
ARRAY_SUFFIX = ".npy"
#: the last bytes of a complete PNG
PNG_END = b"IEND\xaeB`\x82"


def watch_depth_folders(
    folders: Sequence[str | Path], depth_scale: float, stop: threading.Event, timeout: float | None = None
) -> Iterator[Arrival]:
    """Yield the frames of depth images that are added to the folders, one folder for each camera.

    Files that are there already are not read. Frame `n` is complete when every folder has its `n`-th new image, in the
    order of the numbers in their names. Images that are still being written are waited for.

    **Arguments:** `depth_scale`, the number of the images' units in a metre; `timeout`, seconds without a new frame after which
    the iteration ends, never where not given.

    **Raises:** `InputError` if a folder does not exist.
    """

    def read(paths: Sequence[Path]) -> DepthFrame:
        depths = tuple(read_depth_file(path, depth_scale) for path in paths)
        return DepthFrame(str(paths[0]), depths, (None,) * len(depths))

    return _watch(folders, DEPTH_SUFFIXES, read, stop, timeout)


def watch_cloud_folder(
    folder: str | Path, unit: str, stop: threading.Event, timeout: float | None = None
) -> Iterator[Arrival]:
    """Yield the clouds that are added to a folder, as `watch_depth_folders` yields images.

    **Raises:** `InputError` if the folder does not exist, or has a depth image.
    """

    def read(paths: Sequence[Path]) -> Scan:
        return read_clouds(paths[0], unit=unit)[0]

    return _watch([folder], MESH_SUFFIXES, read, stop, timeout, _refuse_depth_images(Path(folder)))


def _refuse_depth_images(folder: Path) -> Callable[[], None]:
    """Make a function that looks at the images that are new in a folder of clouds, at first at all of them.

    Pictures, such as textures of meshes, are left out. The function raises `InputError` for a depth image.
    """
    images = _Folder(folder, (*IMAGE_SUFFIXES, EXR_SUFFIX, ARRAY_SUFFIX), with_existing=True)

    def look() -> None:
        images.look()
        while images.complete:
            path = images.complete.popleft().path
            if path.suffix.lower() == ARRAY_SUFFIX:
                raise InputError(
                    f"{path}: arrays are not read from a folder; write them to standard input (--watch -), or write depth "
                    "images as PNG and give --cameras."
                )
            if path.suffix.lower() == EXR_SUFFIX or is_depth_image(path):
                raise InputError(
                    f"{path}: this is a depth image, which needs the intrinsics of the camera; give these with --cameras. Without "
                    f"them the files of the folder are clouds ({', '.join(MESH_SUFFIXES)})."
                )

    return look


def _watch(
    folders: Sequence[str | Path],
    suffixes: Sequence[str],
    read: Callable[[Sequence[Path]], DepthFrame | Scan],
    stop: threading.Event,
    timeout: float | None,
    refuse: Callable[[], None] = lambda: None,
) -> Iterator[Arrival]:
    """Yield frames; `refuse` is called at each look, and raises `InputError` for files that do not belong here."""
    watched = [_Folder(Path(folder), suffixes) for folder in folders]
    last, begin = time.monotonic(), time.time()
    while not stop.is_set():
        refuse()
        for folder in watched:
            folder.look()
        while all(folder.complete for folder in watched):
            files = [folder.complete.popleft() for folder in watched]
            paths, written = [file.path for file in files], max(file.written for file in files)
            age = time.time() - max(file.arrived for file in files)
            arrived = time.monotonic() - max(age, 0.0)
            yield Arrival(str(paths[0]), written - begin, arrived, lambda paths=paths: read(paths))
            if stop.is_set():
                return
            # the consumer may take longer than the timeout, and files arrive meanwhile
            last = time.monotonic()
        if timeout is not None and time.monotonic() - last > timeout:
            return
        stop.wait(POLL_SECONDS)


class _File(NamedTuple):
    path: Path
    #: the time of its last change, seconds since the epoch
    written: float
    #: the same, but not before the look that did not see it: a copy may have the time of the original
    arrived: float


class _Folder:
    """New files of a folder: those that are complete, in their order. Files that are there already are new if `with_existing`."""

    def __init__(self, folder: Path, suffixes: Sequence[str], with_existing: bool = False):
        self.folder, self.suffixes = folder, suffixes
        self.complete: deque[_File] = deque()
        #: files that are not complete, each with the time of the last look without it
        self._growing: list[tuple[Path, float]] = []
        self._looked = time.time()
        self._changed = 0.0
        self._known = set() if with_existing else set(self._names())

    def look(self) -> None:
        """Look for new files, and move those that are complete."""
        before, self._looked = self._looked, time.time()
        new = [name for name in self._names() if name not in self._known]
        self._known.update(new)
        paths = sorted((self.folder / name for name in new), key=natural_sort_key)
        self._growing += [(path, before) for path in paths]
        while self._growing and (written := self._first_completed()) is not None:
            path, unseen = self._growing.pop(0)
            self.complete.append(_File(path, written, max(written, unseen)))

    def _first_completed(self) -> float | None:
        """Return the time of the last change of the first file once it is complete; None before.

        A file after which another one was completed is waited for only briefly.
        """
        path = self._growing[0][0]
        overtaken = any(_completed(later) is not None for later, _ in self._growing[1:])
        return _completed(path, OVERTAKEN_WAIT_SECONDS if overtaken else MAX_WAIT_SECONDS)

    def _names(self) -> list[str]:
        """List the files of the folder if it may have changed since the last look. Raises `InputError`."""
        try:
            changed = os.stat(self.folder).st_mtime
            if changed == self._changed and time.time() - changed > FOLDER_CLOCK_SECONDS:
                return []
            names = [name for name in os.listdir(self.folder) if name.lower().endswith(tuple(self.suffixes))]
        except OSError as error:
            raise InputError(
                f"{self.folder}: this folder cannot be read ({error.strerror}); make it before frames arrive."
            ) from None
        self._changed = changed
        return [name for name in names if not name.startswith(".")]


def _completed(path: Path, max_wait: float = MAX_WAIT_SECONDS) -> float | None:
    """Return the time of a file's last change once it is complete; None before.

    A PNG has its own end. Any other file is complete if it did not change for a while. Every file is that did not change for
    `max_wait` seconds.
    """
    try:
        with open(path, "rb") as file:
            status = os.fstat(file.fileno())
            age = time.time() - status.st_mtime
            if path.suffix.lower() == ".png" and status.st_size > len(PNG_END):
                file.seek(-len(PNG_END), os.SEEK_END)
                if file.read() == PNG_END:
                    return status.st_mtime
            elif status.st_size and age > SETTLE_SECONDS:
                return status.st_mtime
            return status.st_mtime if age > max_wait else None
    except OSError:
        # renamed or removed; its reader tells so
        return time.time()
