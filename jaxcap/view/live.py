"""A live view of `jaxcap track`: frames are read from the run's journal as soon as they are solved.

An incomplete record is ignored until it is complete, and the journal may not exist yet.
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
from ..errors import InputError, user_message
from ..io.archives.journal import read_header, read_records
from .contents import Take
from .figures.posing import PosedMotion

JOURNAL = "journal"
#: seconds between two reads
POLL_SECONDS = 0.2


def record_poses(
    path: Path, skeleton: Skeleton, header: Mapping[str, object], records: Float[np.ndarray, "N width"]
) -> Pose:
    """Decode the poses in a run's records: translations, rotations and scale, from the header's offset on.

    **Raises:** `InputError` if the header has no offset, or is of another skeleton.
    """
    at, names = header.get("pose at"), header.get("joints")
    if not isinstance(at, int) or not isinstance(names, list):
        raise InputError(
            f"{path}: this journal does not give the offset of its poses, so it is not of a run of jaxcap track; give "
            "the folder of a run."
        )
    if tuple(names) != skeleton.names:
        raise InputError(
            f"{path}: this run is of another body: it has {len(names)} joints, {', '.join(names)}, and the given body "
            f"has {', '.join(skeleton.names)}; give the body of the run with --body."
        )
    joints = skeleton.num_joints
    ends = at + np.cumsum([0, 3 * joints, 4 * joints, 1])
    return Pose(
        jnp.asarray(records[:, ends[0] : ends[1]].reshape(-1, joints, 3), jnp.float32),
        jnp.asarray(records[:, ends[1] : ends[2]].reshape(-1, joints, 4), jnp.float32),
        jnp.asarray(records[:, ends[2]], jnp.float32),
    )


def follow_run(folder: Path, body: Body, rate: float = 30.0) -> Take:
    """Make the take of an unfinished run from its frames so far, or from the rest pose if it has none.

    **Raises:** `InputError` if its journal is invalid, or of another body.
    """
    motion = PosedMotion(body.skeleton, body, _one_frame(rest_pose(body.skeleton)))
    take = Take(folder.name, motion, rate, run_folder=folder)
    RunFollower(take).poll()
    return take


class RunFollower:
    """Reads new frames of a running take: `poll` once, or `start` to repeat it in a thread."""

    def __init__(self, take: Take):
        assert take.run_folder is not None
        self.take, self.path = take, take.run_folder / JOURNAL
        #: number of frames of the run in the take, not counting an initial rest pose
        self.count = 0
        #: the error of the last read, in a sentence
        self.error = ""
        self._size = -1
        self._header: object = None
        self._stop = threading.Event()

    def poll(self) -> bool:
        """Read new frames; return whether there were any. Raises `InputError` if the run is of another
        body."""
        try:
            size = self.path.stat().st_size
        except OSError:
            return False
        if size == self._size:
            return False
        header = read_header(self.path)
        if header != self._header or size < self._size:
            # the run was restarted
            self.count, self._header = 0, header
        records = read_records(self.path, self.count)
        if len(records):
            poses = record_poses(self.path, self.take.motion.skeleton, header, records)
            if self.count:
                self.take.motion.extend(poses)
            else:
                self.take.motion.replace(poses)
            self.count += len(records)
        # set last, so that the next read finds the same error again
        self._size = size
        return len(records) > 0

    def start(self) -> None:
        """Read every fifth of a second, until `stop`."""
        threading.Thread(target=self._poll_forever, daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _poll_forever(self) -> None:
        while not self._stop.wait(POLL_SECONDS):
            try:
                self.poll()
                self.error = ""
            except InputError as error:
                # an incomplete header counts as not written yet
                self.error = user_message(error)
            except Exception as error:
                # the cause may be gone at the next read
                self.error = f"{self.path}: its frames could not be read ({type(error).__name__}: {error})."


def _one_frame(pose: Pose) -> Pose:
    return Pose(pose.translations[None], pose.rotations[None], pose.scale[None])
