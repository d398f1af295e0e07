"""The contents of a glTF 2.0 file (`.glb`, `.gltf`): its arrays, and its node transforms over time."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.interpolate import PPoly
from scipy.spatial.transform import Rotation, Slerp

from ...errors import InputError
from ..archives.archive import MAX_EXPANSION, MIN_MEMORY_LIMIT
from ..archives.npz import MIN_QUATERNION_NORM
from ..skinned.clip import clip_names, clip_number
from ..text import MAX_NUMBER
from .gltf_clock import count_frames, time_range
from .gltf_document import missing_skin_error, read_document
from .gltf_parts import Part
from .gltf_scene import TYPE_SIZES, node_parents

#: NumPy types by glTF code
_COMPONENT_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
#: default transform of a node
_DEFAULT_TRANSFORM = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}
#: extensions that do not affect geometry
_IGNORED_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "KHR_mesh_quantization", "KHR_lights_")

#: translation `(F, 3)`, rotation (xyzw) and scale of a node; one frame if it is static
NodeTransform = dict[str, np.ndarray]


class GltfFile:
    """A complete file with a skin; `clip` names one of its animations, the first if None.

    **Raises:** `InputError` if the file is not complete, has no skin, or uses an unsupported compression.
    """

    def __init__(self, path: str | Path, clip: str | None = None):
        self.path = Path(path)
        root, self.buffers = read_document(self.path)
        self.nodes, self.skins = root.parts("nodes"), root.parts("skins")
        if not self.skins:
            raise missing_skin_error(path)
        for name in root.values("extensionsRequired"):
            if not str(name).startswith(_IGNORED_EXTENSIONS):
                raise InputError(
                    f"{path}: this file requires the extension {name}; export it without compression."
                )
        self.meshes, self.animations = root.parts("meshes"), root.parts("animations")
        self._accessors, self._views = root.parts("accessors"), root.parts("bufferViews")
        self._room = max(MIN_MEMORY_LIMIT, MAX_EXPANSION * sum(len(buffer or b"") for buffer in self.buffers))
        #: index of the selected animation
        self.clip = clip_number(clip_names([one.text("name") for one in self.animations]), clip, path)
        #: the parent of each node that has one
        self.parents = node_parents(self.nodes)

    def reserve_memory(self, numbers: int, purpose: str) -> None:
        """Count numbers that are computed from the file.

        Raises `InputError` if their memory exceeds the limit for its size.
        """
        self._room -= 8 * numbers
        if self._room < 0:
            raise InputError(
                f"{self.path}: {purpose} needs more memory than a file of this size may use; it is damaged or "
                "malicious, so export it again."
            )

    def array(self, index: int | None, width: int, purpose: str) -> Float[np.ndarray, "N W"]:
        """Read the elements of an accessor as rows of a `width`; normalised integers become fractions.

        Elements that a sparse accessor replaces have their new values.

        **Raises:** `InputError` if there is none, it points outside of the file, or it has another width;
        `purpose` names its purpose.
        """
        if index is None:
            raise InputError(f"{self.path}: {purpose} has no data; export it again.")
        accessor = self._accessors[index] if index < len(self._accessors) else None
        if accessor is None:
            raise InputError(
                f"{self.path}: {purpose} refers to accessor {index}, but there are only {len(self._accessors)}; export it again."
            )
        if "sparse" not in accessor:
            return self._dense(accessor, width, purpose)
        count, sparse = accessor.integer("count"), accessor.part("sparse")
        self.reserve_memory(count * width, purpose)
        rows = np.zeros((count, width))
        if "bufferView" in accessor:
            rows = self._dense(accessor, width, purpose)
        changed = {"count": sparse.integer("count"), "type": "SCALAR"}
        numbers = Part({**sparse.part("indices").content, **changed}, f"{accessor.where}.sparse.indices")
        shared = {key: accessor.content.get(key) for key in ("componentType", "type", "normalized")}
        values = Part(
            {**sparse.part("values").content, **shared, "count": changed["count"]},
            f"{accessor.where}.sparse.values",
        )
        places = self._dense(numbers, 1, purpose)[:, 0].astype(np.int64)
        if places.max(initial=0) >= count or places.min(initial=0) < 0:
            raise InputError(
                f"{accessor.where} replaces element {places.max()} of {count}; the file is damaged."
            )
        rows[places] = self._dense(values, width, purpose)
        return rows

    def _dense(self, accessor: Part, width: int, purpose: str) -> Float[np.ndarray, "N W"]:
        """Read the elements of an accessor with a buffer view."""
        place = accessor.index("bufferView", len(self._views))
        if place is None:
            raise accessor.type_error("bufferView", "the index of its buffer view")
        kind, view = accessor.integer("componentType"), self._views[place]
        if kind not in _COMPONENT_TYPES:
            raise accessor.type_error("componentType", f"one of {', '.join(map(str, _COMPONENT_TYPES))}")
        if TYPE_SIZES.get(accessor.text("type")) != width:
            wanted = next(name for name, count in TYPE_SIZES.items() if count == width)
            raise accessor.type_error("type", f"{wanted} for {purpose}")
        buffer = view.integer("buffer")
        numbers = self.buffers[buffer] if buffer < len(self.buffers) else None
        if numbers is None:
            raise InputError(f"{self.path}: buffer {buffer} is not in this file; export it as .glb.")
        number, count = np.dtype(_COMPONENT_TYPES[kind]), accessor.integer("count")
        size = width * number.itemsize
        stride = view.integer("byteStride") or size
        start = view.integer("byteOffset") + accessor.integer("byteOffset")
        if stride < size or start + stride * max(count - 1, 0) + size * min(count, 1) > len(numbers):
            raise InputError(
                f"{accessor.where} refers to data beyond the end of its buffer; the file is damaged."
            )
        self.reserve_memory(count * width, purpose)
        strides = (stride, number.itemsize)
        rows = np.ndarray((count, width), number, numbers, start, strides).astype(float)
        if not (np.abs(rows) <= MAX_NUMBER).all():
            raise InputError(
                f"{accessor.where} contains numbers that are not finite or too large for {purpose}."
            )
        if accessor.content.get("normalized") and number.kind != "f":
            rows = np.maximum(rows / np.iinfo(number).max, -1.0)
        return rows

    def rest_transform(self, index: int) -> NodeTransform:
        """Return the local transform of a node without animation, `(1, ...)`. Raises `InputError`."""
        node = self.nodes[index]
        matrix = node.numbers("matrix", 16)
        if matrix is None:
            found = {name: node.numbers(name, len(plain)) for name, plain in _DEFAULT_TRANSFORM.items()}
            part = {
                name: np.array(_DEFAULT_TRANSFORM[name] if values is None else values)[None]
                for name, values in found.items()
            }
            self._check_quaternions(part["rotation"], f"{node.where}.rotation")
            return part
        columns = matrix.reshape(4, 4).T
        sizes = np.linalg.norm(columns[:3, :3], axis=0)
        turn = columns[:3, :3] / np.where(sizes > 0, sizes, 1.0)
        if not np.linalg.det(turn) > MIN_QUATERNION_NORM:
            raise InputError(
                f"{node.where}: its matrix is singular or mirrors; write a matrix of a rotation and a scale."
            )
        return {
            "translation": columns[None, :3, 3],
            "rotation": Rotation.from_matrix(turn).as_quat()[None],
            "scale": sizes[None],
        }

    def sample_animation(self, rate: float | None) -> tuple[np.ndarray, dict[int, NodeTransform]]:
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
            name, node = target.text("path"), target.index("node", len(self.nodes))
            if name not in _DEFAULT_TRANSFORM or node is None:
                continue
            place = channel.index("sampler", len(samplers))
            if place is None:
                raise channel.type_error("sampler", "the index of a sampler")
            used.append((name, node, place))
        # an animation of shape keys alone lasts as long as their keys
        times = [keys[place] for _, _, place in used] or keys
        if not times:
            raise InputError(f"{animation.where} has no samplers; export it with its keys.")
        count = count_frames(times, rate, self.path)
        self.reserve_memory(count, "the animation at this rate")
        first, last = time_range(times)
        clock = np.linspace(first, last, count) if rate is None else first + np.arange(count) / rate
        moving: dict[int, NodeTransform] = {}
        for name, node, place in used:
            self.reserve_memory(len(clock) * len(_DEFAULT_TRANSFORM[name]), "the animation")
            stand = moving.setdefault(node, self.rest_transform(node))
            stand[name] = self._sample_property(samplers[place], keys[place], name, clock)
        return clock, moving

    def world_transforms(
        self, animated: Mapping[int, NodeTransform], node_indices: Iterable[int]
    ) -> dict[int, Float[np.ndarray, "F 4 4"]]:
        """Compute the transforms of `node_indices` nodes into the world.

        There is one frame for a node with no animation on it or above it. Raises `InputError`.
        """
        done: dict[int, np.ndarray] = {}
        for number in node_indices:
            chain = [number]
            while chain[-1] not in done and chain[-1] in self.parents:
                chain.append(self.parents[chain[-1]])
            for node in reversed(chain):
                if node in done:
                    continue
                part = animated[node] if node in animated else self.rest_transform(node)
                count = max(map(len, part.values()))
                local = np.tile(np.eye(4), (count, 1, 1))
                local[:, :3, :3] = Rotation.from_quat(part["rotation"]).as_matrix() * part["scale"][:, None]
                local[:, :3, 3] = part["translation"]
                done[node] = done[self.parents[node]] @ local if node in self.parents else local
                self.reserve_memory(done[node].size, "the motion of its nodes")
                if not np.abs(done[node]).max(initial=0) <= MAX_NUMBER:
                    raise InputError(f"{self.nodes[node].where} has a transform with too large numbers.")
        return done

    def _times(self, sampler: Part) -> Float[np.ndarray, "K"]:
        """Read the times of keys, which must increase. Raises `InputError`."""
        times = self.array(sampler.index("input", len(self._accessors)), 1, f"{sampler.where}.input")[:, 0]
        if not len(times) or (np.diff(times) <= 0).any():
            raise InputError(f"{sampler.where}: its times do not increase; export the animation again.")
        return times

    def _sample_property(
        self, sampler: Part, times: Float[np.ndarray, "K"], name: str, sample_times: Float[np.ndarray, "F"]
    ) -> Float[np.ndarray, "F N"]:
        """Sample the property `name` of a node at all times of the clock."""
        how = sampler.text("interpolation", "LINEAR")
        where, place = f"{sampler.where}.output", sampler.index("output", len(self._accessors))
        numbers, of_each = (
            self.array(place, len(_DEFAULT_TRANSFORM[name]), where),
            3 if how == "CUBICSPLINE" else 1,
        )
        if len(numbers) != of_each * len(times):
            raise InputError(
                f"{sampler.where} has {len(times)} times and {len(numbers)} values; expected {of_each} for each."
            )
        keys = numbers.reshape(len(times), of_each, -1)
        numbers = keys[:, of_each // 2]
        if name == "rotation":
            self._check_quaternions(numbers, where)
        inside = np.clip(sample_times, times[0], times[-1])
        if len(times) > 1 and of_each == 3:
            curve = _spline(times, keys)(inside)
            if name == "rotation":
                self._check_quaternions(curve, where)
            return curve
        if len(times) == 1:
            return np.tile(numbers, (len(sample_times), 1))
        if how == "STEP":
            return numbers[np.searchsorted(times, inside, "right") - 1]
        if name == "rotation":
            return Slerp(times, Rotation.from_quat(numbers))(inside).as_quat()
        return np.stack([np.interp(inside, times, column) for column in numbers.T], 1)

    def _check_quaternions(self, quaternions: Float[np.ndarray, "N 4"], where: str) -> None:
        """Check that no quaternion is zero. Raises `InputError`."""
        long = np.linalg.norm(quaternions, axis=1)
        if not (long > MIN_QUATERNION_NORM).all():
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
