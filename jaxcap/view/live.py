"""A run of `jaxcap track` while it goes on: its frames as soon as they are solved, from its journal.

A record that is half written is not there yet, and a journal that does not exist yet may come.
"""

import threading
from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..body.body import Body
from ..body.pose import Pose, rest_pose
from ..body.skeleton import Skeleton
from ..errors import InputError, sentence_of
from ..io.archives.journal import read_header, read_records
from .contents import Take
from .figures.posing import PosedMotion

JOURNAL = "journal"
#: seconds between two looks
OFTEN = 0.2


def record_poses(
    path: Path, skeleton: Skeleton, header: Mapping[str, object], records: Float[np.ndarray, "N width"]
) -> Pose:
    """The poses in a run's records: translations, rotations and scale, from the number on that the header tells.

    **Raises:** `InputError` where the header tells of none, or of another skeleton.
    """
    at, names = header.get("pose at"), header.get("joints")
    if not isinstance(at, int) or not isinstance(names, list):
        raise InputError(
            f"{path}: this journal does not tell where its poses are; it is of no run of jaxcap track."
        )
    if tuple(names) != skeleton.names:
        raise InputError(
            f"{path}: this run is of another body: it moves {len(names)} joints, {', '.join(names)}, and this body has "
            f"{', '.join(skeleton.names)}; give the run's own body with --body."
        )
    joints = skeleton.num_joints
    ends = at + np.cumsum([0, 3 * joints, 4 * joints, 1])
    return Pose(
        jnp.asarray(records[:, ends[0] : ends[1]].reshape(-1, joints, 3), jnp.float32),
        jnp.asarray(records[:, ends[1] : ends[2]].reshape(-1, joints, 4), jnp.float32),
        jnp.asarray(records[:, ends[2]], jnp.float32),
    )


def follow_run(folder: Path, body: Body, rate: float = 30.0) -> Take:
    """The take of a run that is not over, with the frames that it has; one at rest where it has none yet.

    **Raises:** `InputError` where its journal is none, or of another body.
    """
    motion = PosedMotion(body.skeleton, body, _one(rest_pose(body.skeleton)))
    take = Take(folder.name, motion, rate, running=folder)
    RunFollower(take).look()
    return take


class RunFollower:
    """Looks after a running take: `look` once, or `start` to look again and again in a thread."""

    def __init__(self, take: Take):
        assert take.running is not None
        self.take, self.path = take, take.running / JOURNAL
        #: how many frames of the run are in the take: at first there may be one at rest, which is none
        self.count = 0
        #: what was wrong when it last looked, in a sentence
        self.told = ""
        self._size = -1
        self._header: object = None
        self._stop = threading.Event()

    def look(self) -> bool:
        """Take up what is new; whether there was anything. Raises `InputError` where the run is of another body."""
        try:
            size = self.path.stat().st_size
        except OSError:
            return False
        if size == self._size:
            return False
        header = read_header(self.path)
        if header != self._header or size < self._size:
            # it was begun anew
            self.count, self._header = 0, header
        records = read_records(self.path, self.count)
        if len(records):
            poses = record_poses(self.path, self.take.motion.skeleton, header, records)
            if self.count:
                self.take.motion.extend(poses)
            else:
                self.take.motion.replace(poses)
            self.count += len(records)
        # only now, so that what is wrong is found again by the next look
        self._size = size
        return len(records) > 0

    def start(self) -> None:
        """Look every fifth of a second, until `stop`."""
        threading.Thread(target=self._go_on, daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _go_on(self) -> None:
        while not self._stop.wait(OFTEN):
            try:
                self.look()
                self.told = ""
            except InputError as error:
                # a header that is half written is one that is not there yet
                self.told = sentence_of(error)
            except Exception as error:
                # whatever it is, the next look may find it gone
                self.told = f"{self.path}: its frames could not be read ({type(error).__name__}: {error})."


def _one(pose: Pose) -> Pose:
    return Pose(pose.translations[None], pose.rotations[None], pose.scale[None])
