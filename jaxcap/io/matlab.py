"""Vectors and numbers of MATLAB files (`.mat`). The expanded size of a file is checked before it is read."""

import math
import os
import struct
import zlib
from pathlib import Path

import numpy as np
from scipy.io import loadmat, whosmat
from scipy.io.matlab import MatReadError

from ..errors import InputError
from .archives.archive import MAX_EXPANSION, MIN_MEMORY_LIMIT

#: length of the header of a file of version 5, and type of a compressed element
_HEADER, _COMPRESSED = 128, 15
_CHUNK_SIZE = 2**20


def read_matlab(path: str | Path) -> dict[str, dict[str, np.ndarray]]:
    """Read the real numbers and vectors of a MATLAB file: those at the top under the name "", and those of each struct.

    Other variables are not read: text, cells, matrices and arrays of structs.

    **Raises:** `InputError` if the file has version 7.3, is no MATLAB file, or would expand beyond the limit for its size.
    """
    limit = max(MIN_MEMORY_LIMIT, MAX_EXPANSION * os.path.getsize(path))
    try:
        _check_expansion(path, limit)
        for name, shape, _ in whosmat(path):
            if 8 * math.prod(shape) > limit:
                raise InputError(
                    f"{path}: the variable '{name}' has the shape {shape}; the file is damaged, so get it again."
                )
        content = loadmat(path, squeeze_me=True, struct_as_record=True)
    except NotImplementedError:
        raise InputError(f"{path}: this is a MATLAB file of version 7.3; save it with -v7.") from None
    except InputError:
        raise
    except (MatReadError, zlib.error, struct.error, ValueError):
        raise InputError(
            f"{path}: this is no MATLAB file, or a damaged one; save it again with -v7."
        ) from None
    found: dict[str, dict[str, np.ndarray]] = {"": {}}
    for name, value in content.items():
        value = np.asarray(value)
        if name.startswith("__") or (value.dtype.names is not None and value.ndim):
            continue
        if value.dtype.names is not None:
            found[name] = _numbers({field: np.asarray(value[field].item()) for field in value.dtype.names})
        else:
            found[""] |= _numbers({name: value})
    return found


def _numbers(values: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {
        name: each.astype(float)
        for name, each in values.items()
        if each.dtype.kind in "iuf" and each.ndim < 2
    }


def _check_expansion(path: str | Path, limit: int) -> None:
    """Check the size of the compressed elements, without keeping them. Raises `InputError`."""
    total = 0
    with open(path, "rb") as file:
        head = file.read(_HEADER)
        order = {b"IM": "<", b"MI": ">"}.get(head[126:128])
        # version 4 has no compression, and 7.3 is refused by its reader
        if order is None or head[124:126] not in (b"\x00\x01", b"\x01\x00"):
            return
        while len(tag := file.read(8)) == 8:
            kind, length = struct.unpack(f"{order}II", tag)
            if kind != _COMPRESSED:
                file.seek(length, os.SEEK_CUR)
                continue
            inflate = zlib.decompressobj()
            while length > 0 and (piece := file.read(min(length, _CHUNK_SIZE))):
                length -= len(piece)
                while piece:
                    total += len(inflate.decompress(piece, _CHUNK_SIZE))
                    piece = inflate.unconsumed_tail
                    if total > limit:
                        raise InputError(
                            f"{path}: the file expands to more than {limit / 1e6:.0f} MB; it is damaged or malicious, so get it again."
                        )
