"""What lies in a glTF 2.0 file (`.glb`, `.gltf`): its arrays of numbers, and how its nodes stand and move."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation, Slerp

from ..errors import InputError
from .clip import clip_names, clip_number
from .gltf_document import no_skin, read_document

#: what glTF calls the types of numbers, and how many of them an element has
_NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
#: where a node stands when nothing is said
_REST = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}
#: extensions of which a reader of shapes needs to know nothing
_HARMLESS = ("KHR_materials_", "KHR_texture_", "KHR_mesh_quantization", "KHR_lights_")


class GltfFile:
    """A whole file that has a skin; `clip` names one of its animations, the first where it is None.

    **Raises:** `InputError` where it is not one, or is packed in a way that is not read.
    """

    def __init__(self, path: str | Path, clip: str | None = None):
        self.path = Path(path)
        document, self.buffers = read_document(self.path)
        if not document.skins:
            raise no_skin(path)
        for name in document.extensionsRequired or []:
            if not name.startswith(_HARMLESS):
                raise InputError(f"{path}: this file is packed by {name}; export it without compression.")
        self.document = document
        #: which animation
        self.clip = clip_number(clip_names([one.name for one in document.animations or []]), clip, path)
        #: the node above each that has one
        self.above = {
            child: number for number, node in enumerate(document.nodes) for child in node.children or []
        }

    def array(self, index: int) -> Float[np.ndarray, "N W"]:
        """The numbers of an accessor, a row an element; integers that stand for shares as these."""
        try:
            accessor = self.document.accessors[index]
            if accessor.sparse is not None:
                raise InputError(f"{self.path}: accessor {index} is sparse, which is not read.")
            view = self.document.bufferViews[accessor.bufferView]
            number, width = np.dtype(_NUMBERS[accessor.componentType]), _WIDTHS[accessor.type]
            stride = view.byteStride or width * number.itemsize
            start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
            numbers = self.buffers[view.buffer]
            if numbers is None:
                raise InputError(f"{self.path}: buffer {view.buffer} is not in this file; export it as .glb.")
            rows = np.ndarray(
                (accessor.count, width), number, numbers, start, (stride, number.itemsize)
            ).astype(float)
        except (IndexError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{self.path}: accessor {index} points outside of the file's numbers.") from None
        if accessor.normalized and number.kind != "f":
            rows = np.maximum(rows / np.iinfo(number).max, -1.0)
        return rows

    def still(self) -> list[dict[str, np.ndarray]]:
        """Of every node its translation, rotation (xyzw) and scale without animation, `(1, ...)`."""
        values = []
        for node in self.document.nodes:
            part = {
                name: np.array(getattr(node, name) or plain, float)[None] for name, plain in _REST.items()
            }
            if node.matrix is not None:
                matrix = np.array(node.matrix, float).reshape(4, 4).T
                sizes = np.linalg.norm(matrix[:3, :3], axis=0)
                turn = Rotation.from_matrix(matrix[:3, :3] / np.where(sizes > 0, sizes, 1.0))
                part = {
                    "translation": matrix[None, :3, 3],
                    "rotation": turn.as_quat()[None],
                    "scale": sizes[None],
                }
            values.append(part)
        return values

    def animation(self, rate: float | None) -> tuple[np.ndarray, list[dict[str, np.ndarray]]]:
        """Times of the chosen animation, and what `still` says at these, `(F, ...)`."""
        animation = self.document.animations[self.clip]
        keys = [self.array(sampler.input)[:, 0] for sampler in animation.samplers]
        clock = max(keys, key=len)
        if rate is not None:
            clock = np.arange(clock[0], clock[-1] + 0.5 / rate, 1.0 / rate)
        elif len(clock) > 1:
            clock = np.linspace(clock[0], clock[-1], len(clock))
        values = [
            {name: np.repeat(part, len(clock), 0) for name, part in node.items()} for node in self.still()
        ]
        for channel in animation.channels:
            name, sampler = channel.target.path, animation.samplers[channel.sampler]
            if name not in _REST or channel.target.node is None:
                continue
            if sampler.interpolation == "CUBICSPLINE":
                raise InputError(f"{self.path}: the animation has spline keys; bake it to linear ones.")
            times, numbers = keys[channel.sampler], self.array(sampler.output)
            inside = np.clip(clock, times[0], times[-1])
            if len(times) == 1:
                found = np.tile(numbers, (len(clock), 1))
            elif sampler.interpolation == "STEP":
                found = numbers[np.searchsorted(times, inside, "right") - 1]
            elif name == "rotation":
                found = Slerp(times, Rotation.from_quat(numbers))(inside).as_quat()
            else:
                found = np.stack([np.interp(inside, times, column) for column in numbers.T], 1)
            values[channel.target.node][name] = found
        return clock, values

    def world(self, values: list[dict[str, np.ndarray]]) -> list[np.ndarray]:
        """(F, 4, 4) transforms of every node into the world."""
        done: dict[int, np.ndarray] = {}
        for number in range(len(values)):
            chain = [number]
            while chain[-1] in self.above and self.above[chain[-1]] not in done:
                chain.append(self.above[chain[-1]])
            for node in reversed(chain):
                part = values[node]
                local = np.tile(np.eye(4), (len(part["scale"]), 1, 1))
                local[:, :3, :3] = Rotation.from_quat(part["rotation"]).as_matrix() * part["scale"][:, None]
                local[:, :3, 3] = part["translation"]
                done[node] = done[self.above[node]] @ local if node in self.above else local
        return [done[number] for number in range(len(values))]
