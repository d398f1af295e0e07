"""The posed frames of a motion, computed ahead in chunks of one size, one compiled call each, and cached."""

import threading
from collections import OrderedDict
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...body.body import Body
from ...body.kinematics import forward_kinematics, joint_positions
from ...body.pose import Pose
from ...body.skeleton import Skeleton

#: frames that are posed in one call
CHUNK_FRAMES = 32
#: size of the cache of posed vertices of each motion, bytes
CACHE_BYTES = 256 * 2**20


class PosedFrame(NamedTuple):
    """The drawn geometry of one frame, metres."""

    #: vertices of the body; empty for a skeleton without a body
    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "J 3"]
    #: rotations of the bones from rest, times the pose's scale
    rotations: Float[np.ndarray, "J 3 3"]


class PosedMotion:
    """A motion that may grow while several windows show it.

    **Arguments:** `skeleton`; its `body`, if any; `poses`, stacked.
    """

    def __init__(self, skeleton: Skeleton, body: Body | None, poses: Pose):
        self.skeleton, self.body = skeleton, body
        self._poses = [np.asarray(leaf) for leaf in (poses.translations, poses.rotations, poses.scale)]
        size = 4 * 3 * CHUNK_FRAMES * max(1, 0 if body is None else len(body.vertices))
        self._most = max(3, CACHE_BYTES // size)
        #: counter that increases with every change of the frames
        self.version = 0
        self._chunks: OrderedDict[int, tuple[int, Future]] = OrderedDict()
        self._lock = threading.Lock()
        # one thread, so that posing ahead takes at most one core from the shown frame
        self._worker = ThreadPoolExecutor(1)

    def __len__(self) -> int:
        return len(self._poses[2])

    def extend(self, poses: Pose) -> None:
        """Append frames."""
        added = (poses.translations, poses.rotations, poses.scale)
        with self._lock:
            self._poses = [
                np.concatenate([there, np.asarray(new, there.dtype)])
                for there, new in zip(self._poses, added, strict=True)
            ]
            self.version += 1

    def replace(self, poses: Pose) -> None:
        """Replace all frames."""
        with self._lock:
            self._poses = [np.asarray(leaf) for leaf in (poses.translations, poses.rotations, poses.scale)]
            self._chunks.clear()
            self.version += 1

    def frame(self, number: int) -> PosedFrame:
        """Return one frame once it is posed, and start to pose the next chunk."""
        with self._lock:
            # the motion may have become shorter since the caller read its length
            chunk, row = divmod(min(number, len(self) - 1), CHUNK_FRAMES)
            posed = self._chunk(chunk, row)
            if (chunk + 1) * CHUNK_FRAMES < len(self):
                self._chunk(chunk + 1, 0)
        return PosedFrame(*(values[row] for values in posed.result()))

    def _chunk(self, chunk: int, row: int) -> Future:
        """Return a chunk that contains `row`, posed or scheduled."""
        there = self._chunks.get(chunk)
        if there is None or there[0] <= row:
            start, end = chunk * CHUNK_FRAMES, min((chunk + 1) * CHUNK_FRAMES, len(self))
            rows = np.minimum(np.arange(start, start + CHUNK_FRAMES), end - 1)
            poses = Pose(*(jnp.asarray(values[rows]) for values in self._poses))
            there = (end - start, self._worker.submit(_pose_to_numpy, self.skeleton, self.body, poses))
            self._chunks[chunk] = there
        self._chunks.move_to_end(chunk)
        while len(self._chunks) > self._most:
            self._chunks.popitem(last=False)
        return there[1]


def _pose_to_numpy(skeleton: Skeleton, body: Body | None, poses: Pose) -> tuple[np.ndarray, ...]:
    return tuple(np.asarray(values) for values in _pose_chunk(skeleton, body, poses))


@eqx.filter_jit
def _pose_chunk(skeleton: Skeleton, body: Body | None, poses: Pose):
    def one(pose: Pose):
        transforms = forward_kinematics(skeleton, pose)
        vertices = (
            jnp.zeros((0, 3))
            if body is None
            else body.skin.deform(body.vertices, body.skeleton, pose, transforms)
        )
        joints = joint_positions(skeleton, transforms)
        return [value.astype(jnp.float32) for value in (vertices, joints, transforms.rotations)]

    return jax.lax.map(one, poses)
