"""The contents of a glTF 2.0 file (`.glb`, `.gltf`): its arrays, and its node transforms over time."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation, Slerp

from ...errors import InputError
from ..archives.archive import PACKED, ROOM
from ..archives.npz import LEAST
from ..skinned.clip import clip_names, clip_number
from ..text import LARGEST
from .gltf_clock import first_and_last, frames_of
from .gltf_document import no_skin, read_document
from .gltf_parts import Part
from .gltf_scene import WIDTHS, tree

#: NumPy types by glTF code
_NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
#: default transform of a node
_REST = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}
#: extensions that do not affect geometry
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_mesh_quantization", "KHR_lights_")

#: translation `(F, 3)`, rotation (xyzw) and scale of a node; one frame if it is static
Stand = dict[str, np.ndarray]


class GltfFile:
    """A complete file with a skin; `clip` names one of its animations, the first if None.

    **Raises:** `InputError` if the file is not complete, has no skin, or uses an unsupported compression.
    """

    def __init__(self, path: str | Path, clip: str | None = None):
        self.path = Path(path)
        root, self.buffers = read_document(self.path)
        self.nodes, self.skins = root.parts("nodes"), root.parts("skins")
        if not self.skins:
            raise no_skin(path)
        for name in root.values("extensionsRequired"):
            if not str(name).startswith(_HARMLESS):
                raise InputError(
                    f"{path}: this file requires the extension {name}; export it without compression."
                )
        self.meshes, self.animations = root.parts("meshes"), root.parts("animations")
        self._accessors, self._views = root.parts("accessors"), root.parts("bufferViews")
        self._room = max(ROOM, PACKED * sum(len(buffer or b"") for buffer in self.buffers))
        #: index of the selected animation
        self.clip = clip_number(clip_names([one.word("name") for one in self.animations]), clip, path)
        #: the parent of each node that has one
        self.above = tree(self.nodes)

    def spend(self, numbers: int, what: str) -> None:
        """Count numbers that are computed from the file.

        Raises `InputError` if their memory exceeds the limit for its size.
        """
        self._room -= 8 * numbers
        if self._room < 0:
            raise InputError(
                f"{self.path}: {what} needs more memory than a file of this size may use; it is damaged or "
                "malicious, so export it again."
            )

    def array(self, index: int | None, width: int, what: str) -> Float[np.ndarray, "N W"]:
        """Read the elements of an accessor as rows of a `width`; normalised integers become fractions.

        **Raises:** `InputError` if there is none, it points outside of the file, or it has another width;
        `what` names its purpose.
        """
        if index is None:
            raise InputError(f"{self.path}: {what} has no data; export it again.")
        accessor = self._accessors[index] if index < len(self._accessors) else None
        if accessor is None:
            raise InputError(
                f"{self.path}: {what} refers to accessor {index}, but there are only {len(self._accessors)}; export it again."
            )
        if "sparse" in accessor:
            raise InputError(
                f"{accessor.where} is sparse, which is not supported; export it as a dense array."
            )
        place = accessor.index("bufferView", len(self._views))
        if place is None:
            raise accessor.wrong("bufferView", "the index of its buffer view")
        kind, view = accessor.whole("componentType"), self._views[place]
        if kind not in _NUMBERS:
            raise accessor.wrong("componentType", f"one of {', '.join(map(str, _NUMBERS))}")
        if WIDTHS.get(accessor.word("type")) != width:
            wanted = next(name for name, count in WIDTHS.items() if count == width)
            raise accessor.wrong("type", f"{wanted} for {what}")
        buffer = view.whole("buffer")
        numbers = self.buffers[buffer] if buffer < len(self.buffers) else None
        if numbers is None:
            raise InputError(f"{self.path}: buffer {buffer} is not in this file; export it as .glb.")
        number, count = np.dtype(_NUMBERS[kind]), accessor.whole("count")
        size = width * number.itemsize
        stride = view.whole("byteStride") or size
        start = view.whole("byteOffset") + accessor.whole("byteOffset")
        if stride < size or start + stride * max(count - 1, 0) + size * min(count, 1) > len(numbers):
            raise InputError(
                f"{accessor.where} refers to data beyond the end of its buffer; the file is damaged."
            )
        self.spend(count * width, what)
        strides = (stride, number.itemsize)
        rows = np.ndarray((count, width), number, numbers, start, strides).astype(float)
        if not (np.abs(rows) <= LARGEST).all():
            raise InputError(
                f"{accessor.where} contains numbers that are not finite or too large for {what}."
            )
        if accessor.content.get("normalized") and number.kind != "f":
            rows = np.maximum(rows / np.iinfo(number).max, -1.0)
        return rows

    def still(self, number: int) -> Stand:
        """Return the local transform of a node without animation, `(1, ...)`. Raises `InputError`."""
        node = self.nodes[number]
        matrix = node.numbers("matrix", 16)
        if matrix is None:
            found = {name: node.numbers(name, len(plain)) for name, plain in _REST.items()}
            part = {
                name: np.array(_REST[name] if values is None else values)[None]
                for name, values in found.items()
            }
            self._check_turns(part["rotation"], f"{node.where}.rotation")
            return part
        columns = matrix.reshape(4, 4).T
        sizes = np.linalg.norm(columns[:3, :3], axis=0)
        turn = columns[:3, :3] / np.where(sizes > 0, sizes, 1.0)
        if not np.linalg.det(turn) > LEAST:
            raise InputError(
                f"{node.where}: its matrix is singular or mirrors; write a matrix of a rotation and a scale."
            )
        return {
            "translation": columns[None, :3, 3],
            "rotation": Rotation.from_matrix(turn).as_quat()[None],
            "scale": sizes[None],
        }

    def animation(self, rate: float | None) -> tuple[np.ndarray, dict[int, Stand]]:
        """Sample the selected animation.

        Return the times and the local transforms of the animated nodes, `(F, ...)`.

        Raises `InputError`.
        """
        animation = self.animations[self.clip]
        samplers = animation.parts("samplers")
        keys = [self._times(sampler) for sampler in samplers]
        used: list[tuple[str, int, int]] = []
        for channel in animation.parts("channels"):
            target = channel.part("target")
            name, node = target.word("path"), target.index("node", len(self.nodes))
            if name not in _REST or node is None:
                continue
            place = channel.index("sampler", len(samplers))
            if place is None:
                raise channel.wrong("sampler", "the index of a sampler")
            used.append((name, node, place))
        # an animation of shape keys alone lasts as long as their keys
        times = [keys[place] for _, _, place in used] or keys
        if not times:
            raise InputError(f"{animation.where} has no samplers; export it with its keys.")
        count = frames_of(times, rate, self.path)
        self.spend(count, "the animation at this rate")
        first, last = first_and_last(times)
        clock = np.linspace(first, last, count) if rate is None else first + np.arange(count) / rate
        moving: dict[int, Stand] = {}
        for name, node, place in used:
            self.spend(len(clock) * len(_REST[name]), "the animation")
            stand = moving.setdefault(node, self.still(node))
            stand[name] = self._sampled(samplers[place], keys[place], name, clock)
        return clock, moving

    def world(
        self, moving: Mapping[int, Stand], wanted: Iterable[int]
    ) -> dict[int, Float[np.ndarray, "F 4 4"]]:
        """Compute the transforms of `wanted` nodes into the world.

        There is one frame for a node with no animation on it or above it. Raises `InputError`.
        """
        done: dict[int, np.ndarray] = {}
        for number in wanted:
            chain = [number]
            while chain[-1] not in done and chain[-1] in self.above:
                chain.append(self.above[chain[-1]])
            for node in reversed(chain):
                if node in done:
                    continue
                part = moving[node] if node in moving else self.still(node)
                count = max(map(len, part.values()))
                local = np.tile(np.eye(4), (count, 1, 1))
                local[:, :3, :3] = Rotation.from_quat(part["rotation"]).as_matrix() * part["scale"][:, None]
                local[:, :3, 3] = part["translation"]
                done[node] = done[self.above[node]] @ local if node in self.above else local
                self.spend(done[node].size, "the motion of its nodes")
                if not np.abs(done[node]).max(initial=0) <= LARGEST:
                    raise InputError(f"{self.nodes[node].where} has a transform with too large numbers.")
        return done

    def _times(self, sampler: Part) -> Float[np.ndarray, "K"]:
        """Read the times of keys, which must increase. Raises `InputError`."""
        times = self.array(sampler.index("input", len(self._accessors)), 1, f"{sampler.where}.input")[:, 0]
        if not len(times) or (np.diff(times) <= 0).any():
            raise InputError(f"{sampler.where}: its times do not increase; export the animation again.")
        return times

    def _sampled(
        self, sampler: Part, times: Float[np.ndarray, "K"], name: str, clock: Float[np.ndarray, "F"]
    ) -> Float[np.ndarray, "F N"]:
        """Sample the property `name` of a node at all times of the clock."""
        how = sampler.word("interpolation", "LINEAR")
        where, place = f"{sampler.where}.output", sampler.index("output", len(self._accessors))
        numbers, of_each = self.array(place, len(_REST[name]), where), 3 if how == "CUBICSPLINE" else 1
        if len(numbers) != of_each * len(times):
            raise InputError(
                f"{sampler.where} has {len(times)} times and {len(numbers)} values; expected {of_each} for each."
            )
        keys = numbers.reshape(len(times), of_each, -1)
        numbers = keys[:, of_each // 2]
        if name == "rotation":
            self._check_turns(numbers, where)
        inside = np.clip(clock, times[0], times[-1])
        if len(times) > 1 and of_each == 3:
            curve = _spline(times, keys)(inside)
            if name == "rotation":
                self._check_turns(curve, where)
            return curve
        if len(times) == 1:
            return np.tile(numbers, (len(clock), 1))
        if how == "STEP":
            return numbers[np.searchsorted(times, inside, "right") - 1]
        if name == "rotation":
            return Slerp(times, Rotation.from_quat(numbers))(inside).as_quat()
        return np.stack([np.interp(inside, times, column) for column in numbers.T], 1)

    def _check_turns(self, quaternions: Float[np.ndarray, "N 4"], where: str) -> None:
        """Check that no quaternion is zero. Raises `InputError`."""
        long = np.linalg.norm(quaternions, axis=1)
        if not (long > LEAST).all():
            raise InputError(
                f"{where} has a zero quaternion in row {int(long.argmin())}; write a unit quaternion."
            )


def _spline(times: Float[np.ndarray, "K"], keys: Float[np.ndarray, "K 3 N"]) -> PPoly:
    """Build the cubic spline through keys with in-tangent, value, out-tangent (glTF 2.0, appendix C.5)."""
    long = np.diff(times)[:, None]
    (begin, out), (into, end) = keys[:-1, 1:].swapaxes(0, 1), keys[1:, :2].swapaxes(0, 1)
    mean = (end - begin) / long
    cubic, square = (out + into - 2 * mean) / long**2, (3 * mean - 2 * out - into) / long
    return PPoly(np.stack([cubic, square, out, begin]), times)
