"""Registered meshes: a surface in motion."""

from typing import overload

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ..arguments import as_jax_array, check_fields
from ..value_checks import check_faces, check_rate


class MeshSequence(eqx.Module):
    """A surface in motion: meshes with the same vertices in the same order, metres.

    NumPy arrays are accepted and become JAX arrays. An integer index returns the vertices of a mesh,
    `(V, 3)`; a slice or an array of indices a shorter sequence.
    """

    vertices: Float[Array, "F V 3"] = eqx.field(converter=as_jax_array)
    #: counter-clockwise as seen from outside
    faces: Int[Array, "T 3"] = eqx.field(converter=as_jax_array)
    #: meshes per second
    rate: float = eqx.field(static=True, default=30.0)

    def __check_init__(self):
        check_fields(self)
        check_rate("MeshSequence", self.rate)
        check_faces("MeshSequence", self.faces, self.vertices.shape[1])

    def __len__(self) -> int:
        return self.vertices.shape[0]

    @overload
    def __getitem__(self, frames: int | np.integer) -> Float[Array, "V 3"]: ...
    @overload
    def __getitem__(self, frames: slice | np.ndarray) -> "MeshSequence": ...
    def __getitem__(self, frames):
        if isinstance(frames, (int, np.integer)):
            if not -len(self) <= frames < len(self):
                raise IndexError(f"There is no mesh {frames} in a sequence of {len(self)} meshes.")
            return self.vertices[frames]
        step = abs(frames.step or 1) if isinstance(frames, slice) else 1
        return MeshSequence(self.vertices[frames], self.faces, self.rate / step)
