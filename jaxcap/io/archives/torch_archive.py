"""The tensors of TorchScript files (`.pt`), without PyTorch: a zip of raw tensors, and a pickle that names them.

The pickle is interpreted and never unpickled, as those of body models are, and the code in the file is not read.
"""

import math
import os
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ..system.reader_errors import reader_of
from ..text import shortened
from .archive import MAX_ARRAYS
from .pickle_machine import PickleMachine, Symbol, role_of

#: largest size of the pickle, bytes, and number of axes of a tensor
MAX_PICKLE, MAX_AXES = 2**24, 16
#: largest depth of modules
MAX_DEPTH = 32
#: modules and names of TorchScript -> their role
_GLOBALS = {
    r"torch\._utils _rebuild_(tensor_v2|parameter)": "tensor",
    r"torch \w+Storage": "storage",
    r"__torch__(\.\w+)* \w+": "module",
}
_DTYPES = {
    "FloatStorage": np.float32,
    "DoubleStorage": np.float64,
    "HalfStorage": np.float16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "CharStorage": np.int8,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
}


@reader_of("a TorchScript file")
def read_torch_arrays(
    path: str | Path, select: Callable[[str], bool] = lambda name: True
) -> dict[str, np.ndarray]:
    """Read the tensors of a TorchScript file with `select` names, as `module.submodule.tensor`.

    **Raises:** `InputError` if the file is no TorchScript archive, is damaged, or a chosen tensor is not in it as it should be.
    """
    if not zipfile.is_zipfile(path):
        raise InputError(
            f"{path}: this is no TorchScript file, which is a zip archive; give a .pt file of `torch.jit.save`."
        )
    with zipfile.ZipFile(path) as file:
        members = {info.filename: info for info in file.infolist()}
        pickles = [name for name in members if name.count("/") == 1 and name.endswith("/data.pkl")]
        if len(pickles) != 1:
            raise InputError(
                f"{path}: this archive has {len(pickles)} files data.pkl; expected one, as in a TorchScript file."
            )
        folder, info = pickles[0].split("/")[0], members[pickles[0]]
        if info.file_size > MAX_PICKLE:
            raise InputError(
                f"{path}: its data.pkl has {info.file_size} bytes; expected at most {MAX_PICKLE}."
            )
        order = members.get(f"{folder}/byteorder")
        if order is not None and (order.file_size > 16 or file.read(order) != b"little"):
            raise InputError(
                f"{path}: the tensors are in the byte order of another machine; save the file on this one."
            )
        root = PickleMachine(file.read(info), _GLOBALS).run()
        tensors = [pair for pair in _walk(root, (), 0, set()) if select(pair[0])]
        if len(tensors) > MAX_ARRAYS:
            raise InputError(f"{path}: the file has {len(tensors)} tensors; expected at most {MAX_ARRAYS}.")
        # a stored member cannot be larger than the file
        limit = 4 * os.path.getsize(path) + 2**20
        found = {}
        for name, record in tensors:
            where = f"{path}: the tensor '{shortened(name)}'"
            found[name] = _tensor(file, members, folder, record, where)
            limit -= found[name].nbytes
            if limit < 0:
                raise InputError(
                    f"{where} needs too much memory for a file of this size; it is damaged or malicious."
                )
    return found


def _walk(value: Any, above: tuple[str, ...], depth: int, seen: set[int]) -> Iterator[tuple[str, Symbol]]:
    """List the tensors of a module and those below it, with their names; a module that occurs again is left out."""
    if role_of(value) == "tensor":
        yield ".".join(above), value
    elif role_of(value) == "module" and depth < MAX_DEPTH and id(value) not in seen:
        seen.add(id(value))
        state = value.state
        for name, each in state.items() if isinstance(state, dict) else ():
            yield from _walk(each, (*above, name), depth + 1, seen)


def _tensor(
    file: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo], folder: str, record: Symbol, where: str
) -> np.ndarray:
    """Read a tensor in C order. Raises `InputError`."""
    arguments = record.arguments or ()
    if arguments and role_of(arguments[0]) == "tensor":  # a parameter around its tensor
        return _tensor(file, members, folder, arguments[0], where)
    match arguments:
        case (
            Symbol(role="persistent", arguments=(tuple() as stored,)),
            int() as start,
            tuple() as shape,
            tuple() as steps,
            *_,
        ):
            pass
        case _:
            raise InputError(f"{where} is not stored as TorchScript stores tensors; save the file again.")
    match stored:
        case ("storage", Symbol(role="storage") as kind, str() as key, *_):
            dtype = _DTYPES.get(kind.name.rsplit(".", 1)[-1])
        case _:
            dtype, key = None, ""
    info = members.get(f"{folder}/data/{key}")
    if dtype is None or info is None or info.compress_type != zipfile.ZIP_STORED:
        raise InputError(
            f"{where} has a type or a storage that is not read; save the file again with `torch.jit.save`."
        )
    numbers = (start, *shape, *steps)
    if (
        not all(isinstance(n, int) and 0 <= n < 2**40 for n in numbers)
        or not len(shape) == len(steps) <= MAX_AXES
    ):
        raise InputError(f"{where} has no valid shape; the file is damaged.")
    count = info.file_size // np.dtype(dtype).itemsize
    last = start + sum((n - 1) * step for n, step in zip(shape, steps, strict=True))
    # more elements than are stored would repeat some
    if math.prod(shape) > count or (math.prod(shape) and last >= count):
        raise InputError(f"{where} needs {last + 1} stored numbers, and the file has {count}; it is damaged.")
    values = np.frombuffer(file.read(info), dtype, count)
    size = values.itemsize
    view = np.lib.stride_tricks.as_strided(values[start:], shape, [size * step for step in steps])
    return np.array(view if math.prod(shape) else np.zeros(shape, dtype), order="C")
