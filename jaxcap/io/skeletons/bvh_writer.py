"""BVH files, written: complete motions at once, or frame by frame in a run that may be killed.

Every joint has three rotations, and every joint that can translate three positions too, so that any pose is
written exactly, for all kinds of joints. Angles are in degrees, in the order Z X Y, and are continuous from
frame to frame, without jumps by a full rotation.
"""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...arguments import checked
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton
from ...errors import InputError, user_message
from ...units import unit_scale
from ..system.atomic import atomic_path
from .twist_axes import is_end_joint

_ROTATION_CHANNELS = "Zrotation Xrotation Yrotation"
_POSITION_CHANNELS = "Xposition Yposition Zposition"
#: digits reserved for the number of frames, which is unknown until the end
_COUNT_WIDTH = 10
#: frames that are written at once
_FRAMES_PER_WRITE = 1000


@checked
def write_bvh(path: str | Path, skeleton: Skeleton, motion: Motion, unit: str | float = "cm") -> None:
    """Write a motion atomically.

    The scale of the poses is applied to the offsets. `unit` is as in `read_bvh`.

    **Raises:** `InputError` if the file cannot be written, the scale changes from frame to frame, or a joint
    translates although its kind does not allow it.
    """
    path = Path(path)
    scales = np.asarray(motion.poses.scale)
    with atomic_path(path) as beside:
        try:
            with BvhWriter(
                beside, skeleton, motion.rate, unit, float(scales[0]) if len(scales) else 1.0
            ) as writer:
                translations, rotations = (
                    np.asarray(motion.poses.translations),
                    np.asarray(motion.poses.rotations),
                )
                for start in range(0, len(scales), _FRAMES_PER_WRITE):
                    some = slice(start, start + _FRAMES_PER_WRITE)
                    writer.write_arrays(translations[some], rotations[some], scales[some], count=False)
        except InputError as error:
            raise InputError(user_message(error).replace(str(beside), str(path))) from None


class BvhWriter:
    """A writer of single poses; after each one the file is a complete BVH file.

        with BvhWriter(path, skeleton, rate=30.0) as writer:
            writer.write(pose)

    `frames` is the number of frames in the file. `BvhWriter.resume` continues a run that was killed.
    """

    def __init__(
        self,
        path: str | Path,
        skeleton: Skeleton,
        rate: float = 30.0,
        unit: str | float = "cm",
        scale: float = 1.0,
    ):
        """Start a new file. `scale` is that of all poses.

        **Raises:** `InputError` if the file cannot be written.
        """
        self._prepare(path, skeleton, rate, unit, scale)
        try:
            self._file = open(self.path, "w+b")  # noqa: SIM115
        except OSError as error:
            raise InputError(
                f"{path}: cannot be written ({error.strerror}); give a path in a writable folder."
            ) from None
        self._file.write(self._header + self._count(0) + self._time)
        self._file.flush()

    @classmethod
    def resume(
        cls,
        path: str | Path,
        skeleton: Skeleton,
        rate: float = 30.0,
        unit: str | float = "cm",
        scale: float = 1.0,
        frames: int | None = None,
    ) -> "BvhWriter":
        """Continue a file with the same arguments after its last complete frame, or after its first `frames`.

        An incomplete frame is dropped.

        **Raises:** `InputError` if the file has another hierarchy, rate or unit, or has fewer frames than
        `frames`.
        """
        self = cls.__new__(cls)
        self._prepare(path, skeleton, rate, unit, scale)
        try:
            self._file = open(self.path, "r+b")  # noqa: SIM115
        except OSError as error:
            raise InputError(
                f"{path}: this file cannot be continued ({error.strerror}); start a new file."
            ) from None
        size = len(self._header) + _COUNT_WIDTH + len(self._time)
        start = self._file.read(size)
        same = (
            start[: len(self._header)] == self._header
            and start[len(self._header) + _COUNT_WIDTH :] == self._time
        )
        if not same:
            self._file.close()
            raise InputError(
                f"{path}: this file cannot be continued, as it has another skeleton, rate or unit; "
                "start a new file."
            )
        end, last = size, b""
        for line in self._file:
            if not line.endswith(b"\n") or len(line.split()) != self._width or self.frames == frames:
                break
            end += len(line)
            self.frames += 1
            last = line
        if frames is not None and self.frames < frames:
            self._file.close()
            raise InputError(f"{path}: the file has {self.frames} complete frames; expected {frames}.")
        if self.frames:
            self._previous = self._parse_angles(last)
        self._file.seek(end)
        self._file.truncate()
        self._rewrite_count()
        return self

    def write(self, pose: Pose) -> None:
        """Append one frame and pass it to the operating system.

        **Raises:** `InputError` if its scale is not the file's, or a joint translates although its kind does
        not allow it.
        """
        arrays = (pose.translations, pose.rotations, pose.scale)
        translations, rotations, scales = (np.asarray(array)[None] for array in arrays)
        self.write_arrays(translations, rotations, scales)

    def write_arrays(
        self,
        translations: Float[np.ndarray, "F J 3"],
        rotations: Float[np.ndarray, "F J 4"],
        scales: Float[np.ndarray, "F"],
        count: bool = True,
    ) -> None:
        """Append the arrays of some frames as `write` does.

        Without `count` the number of frames is written at the end only.
        """
        self._check(translations, scales)
        turned = np.asarray(rotations, float)[:, self._order]
        matrices = Rotation.from_quat(turned.reshape(-1, 4), scalar_first=True).as_matrix()
        angles = _continuous_euler_angles(matrices.reshape(*turned.shape[:2], 3, 3), self._previous)
        self._previous = angles[-1]
        moves = self._is_translating[self._order]
        positions = (self._offsets + translations[:, self._order]) * self._factor
        numbers = np.concatenate([positions, np.degrees(angles)], 2)
        # positions of the joints that translate, and rotations of all
        rows = numbers[:, np.stack([moves, np.ones_like(moves)], 1).repeat(3, 1)]
        line = " ".join(["%.6f"] * self._width) + "\n"
        self._file.write("".join(line % tuple(row) for row in rows.tolist()).encode())
        self.frames += len(rows)
        if count:
            self._rewrite_count()

    def close(self) -> None:
        """Finish the file; a second call has no effect."""
        if not self._file.closed:
            self._rewrite_count()
            self._file.close()

    def __enter__(self) -> "BvhWriter":
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _check(self, translations: np.ndarray, scales: np.ndarray) -> None:
        """Check that frames have the file's scale and only movable joints translate. Raises `InputError`."""
        wrong = np.abs(scales - self.scale) > 1e-6 * abs(self.scale)
        if wrong.any():
            first = int(wrong.argmax())
            raise InputError(
                f"{self.path}: frame {self.frames + first} has the scale {scales[first]:g} and the file "
                f"{self.scale:g}; BVH has one scale for all frames."
            )
        still = np.abs(np.where(self._is_translating[:, None], 0.0, translations)).max(2)
        wrong = still.max(1) > 1e-6
        if wrong.any():
            first = int(wrong.argmax())
            joint = int(still[first].argmax())
            raise InputError(
                f"{self.path}: frame {self.frames + first} translates joint "
                f"'{self._skeleton.names[joint]}', but it is a {self._skeleton.kinds[joint]} joint; use a free joint."
            )

    def _prepare(self, path, skeleton: Skeleton, rate: float, unit: str | float, scale: float) -> None:
        self.path, self.scale, self.frames = Path(path), scale, 0
        self._skeleton = skeleton
        self._factor = scale / unit_scale(unit)
        kinds, parents = np.array(skeleton.kinds), np.array(skeleton.parents)
        self._is_translating = np.isin(kinds, ["translate", "free"]) | (parents < 0)
        header, self._order = _hierarchy(skeleton, self._factor, self._is_translating)
        centres = np.asarray(skeleton.centres, float)
        self._offsets = (centres - np.where(parents[:, None] < 0, 0.0, centres[parents]))[self._order]
        self._width = int(3 * len(self._order) + 3 * self._is_translating[self._order].sum())
        self._previous = np.zeros((len(self._order), 3))
        self._header = (header + "MOTION\nFrames: ").encode()
        self._time = f"\nFrame Time: {1.0 / rate:.10g}\n".encode()

    def _parse_angles(self, line: bytes) -> np.ndarray:
        numbers = iter(line.split())
        rows = [
            [float(next(numbers)) for _ in range(6 if moves else 3)]
            for moves in self._is_translating[self._order]
        ]
        return np.radians([row[-3:] for row in rows])

    def _count(self, frames: int) -> bytes:
        return f"{frames:>{_COUNT_WIDTH}d}".encode()

    def _rewrite_count(self) -> None:
        # the frame first, so that the count never includes a missing one
        self._file.seek(0, os.SEEK_END)
        self._file.flush()
        self._file.seek(len(self._header))
        self._file.write(self._count(self.frames))
        self._file.seek(0, os.SEEK_END)
        self._file.flush()


def _hierarchy(skeleton: Skeleton, factor: float, is_translating: np.ndarray) -> tuple[str, np.ndarray]:
    """Build the HIERARCHY section, and return it with the joints in its order, without End Sites."""
    names, parents = skeleton.names, skeleton.parents
    centres = np.asarray(skeleton.centres, float)
    ends = [is_end_joint(names, parents, skeleton.kinds, joint) for joint in range(len(names))]
    for name in names:
        if any(letter in name for letter in "{}\r\n") or name != name.strip() or not name:
            raise InputError(
                f"The joint name {name!r} cannot be written to BVH; use a name without braces, line breaks and outer blanks."
            )
    lines, order = ["HIERARCHY"], []
    # (joint, depth) to open, or (~joint, depth) to close
    stack = [(joint, 0) for joint in reversed(range(len(names))) if parents[joint] < 0]
    while stack:
        joint, depth = stack.pop()
        indent = "\t" * depth
        if joint < 0:
            lines.append(indent + "}")
            continue
        step = (centres[joint] - (centres[parents[joint]] if parents[joint] >= 0 else 0.0)) * factor
        offset = "OFFSET " + " ".join(f"{x:.8f}" for x in step)
        if ends[joint]:
            lines += [indent + "End Site", indent + "{", f"{indent}\t{offset}", indent + "}"]
            continue
        order.append(joint)
        channels = (
            f"CHANNELS 6 {_POSITION_CHANNELS} {_ROTATION_CHANNELS}"
            if is_translating[joint]
            else f"CHANNELS 3 {_ROTATION_CHANNELS}"
        )
        lines += [f"{indent}{'ROOT' if depth == 0 else 'JOINT'} {names[joint]}", indent + "{"]
        lines += [f"{indent}\t{offset}", f"{indent}\t{channels}"]
        children = [child for child in range(len(names)) if parents[child] == joint]
        if not children:
            lines += [f"{indent}\tEnd Site", f"{indent}\t{{", f"{indent}\t\tOFFSET 0 0 0", f"{indent}\t}}"]
        stack.append((~joint, depth))
        stack += [(child, depth + 1) for child in reversed(children)]
    return "\n".join(lines) + "\n", np.array(order)


def _continuous_euler_angles(r: np.ndarray, previous: np.ndarray) -> np.ndarray:
    """Compute continuous angles `(F, J, 3)` with `R = Rz(a) Rx(b) Ry(c)`.

    Of both solutions and all full rotations, the angles nearest to the previous frame are chosen; `previous`
    `(J, 3)` is the first one. In gimbal lock (b at a right angle), Z keeps its previous value and Y takes the
    rest.
    """
    cosine = np.hypot(r[..., 0, 1], r[..., 1, 1])
    locked = cosine < 1e-9
    a = np.arctan2(-r[..., 0, 1], r[..., 1, 1])
    b = np.arctan2(r[..., 2, 1], cosine)
    angles = np.empty((*r.shape[:2], 3))
    for frame, here in enumerate(_euler_solutions(r, a, b)):
        if locked[frame].any():
            kept = np.where(locked[frame], previous[:, 0], a[frame])
            here = next(_euler_solutions(r[frame, None], kept[None], b[frame, None]))
        both = here - 2 * np.pi * np.round((here - previous) / (2 * np.pi))
        far = np.abs(both - previous).sum(-1)
        previous = angles[frame] = np.where((far[1] < far[0] - 1e-9)[:, None], both[1], both[0])
    return angles


def _euler_solutions(r: np.ndarray, a: np.ndarray, b: np.ndarray) -> Iterator[np.ndarray]:
    """Yield both solutions for the angles of each frame, `(2, J, 3)`, from the first two angles of one."""
    # from the rotation that remains after Z, so that the product is exact even if a is ill-conditioned
    c = np.arctan2(
        np.cos(a) * r[..., 0, 2] + np.sin(a) * r[..., 1, 2],
        np.cos(a) * r[..., 0, 0] + np.sin(a) * r[..., 1, 0],
    )
    one, other = np.stack([a, b, c], -1), np.stack([a + np.pi, np.pi - b, c + np.pi], -1)
    yield from np.stack([one, other], 1)
