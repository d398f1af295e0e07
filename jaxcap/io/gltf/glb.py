"""The binary part of a `.glb` file: arrays packed one after another, each with its accessor."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pygltflib

#: glTF codes of number types, and names of element shapes
_COMPONENTS = {np.dtype("u1"): 5121, np.dtype("<u2"): 5123, np.dtype("<u4"): 5125, np.dtype("<f4"): 5126}
_TYPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4", (4, 4): "MAT4"}
#: targets of buffer views, for rendering
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


class GlbBuilder:
    """Arrays packed into one buffer; `add` returns the index of an array's accessor in `document`."""

    def __init__(self, document: "pygltflib.GLTF2"):
        self.document = document
        self.data = bytearray()

    def add(self, array: np.ndarray, target: int | None = None, bounds: bool = False) -> int:
        """Pack an array `(N, ...)` of `u1`, `u2`, `u4` or `f4`; matrices are stored by columns.

        `bounds` adds its minimum and maximum, which glTF requires for positions and times.
        """
        import pygltflib

        array = np.ascontiguousarray(array)
        element = array.shape[1:]
        raw = np.swapaxes(array, 1, 2) if len(element) == 2 else array
        self.data += b"\0" * (-len(self.data) % 4)
        view = pygltflib.BufferView(buffer=0, byteOffset=len(self.data), byteLength=raw.nbytes, target=target)
        self.data += raw.tobytes()
        self.document.bufferViews.append(view)
        accessor = pygltflib.Accessor(
            bufferView=len(self.document.bufferViews) - 1,
            byteOffset=0,
            componentType=_COMPONENTS[array.dtype],
            count=len(array),
            type=_TYPES[element],
        )
        if bounds:
            accessor.min = np.atleast_1d(array.min(0)).tolist()
            accessor.max = np.atleast_1d(array.max(0)).tolist()
        self.document.accessors.append(accessor)
        return len(self.document.accessors) - 1

    def to_bytes(self) -> bytes:
        """Return the complete `.glb` file with the document and its data."""
        import pygltflib

        self.data += b"\0" * (-len(self.data) % 4)
        self.document.buffers = [pygltflib.Buffer(byteLength=len(self.data))]
        self.document.set_binary_blob(bytes(self.data))
        return b"".join(self.document.save_to_bytes())
