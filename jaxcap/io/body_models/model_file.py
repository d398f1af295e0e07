"""Body models in files of any family that is read."""

from pathlib import Path
from typing import Any

from ...body.body_model import BodyModel
from ...errors import InputError
from ..archives.archive import array_names
from ..archives.pickle_arrays import read_pickled_arrays
from ..kinds import kind_of_arrays
from ..system.reader_errors import reader_of
from .learned import is_own_model, read_own_model
from .mhr import read_mhr
from .skel import ARRAYS as SKEL_ARRAYS
from .skel import TREE, make_skel
from .smpl import ARRAYS as SMPL_ARRAYS
from .smpl import filled_arrays, make_smpl, read_body_model

#: suffixes of files that hold nothing else
MODEL_SUFFIXES = (".pkl", ".pt")


def is_body_model(path: str | Path) -> bool:
    """Test if a file is a body model, by its suffix or the names of its arrays; false if it is damaged."""
    path = Path(path)
    if path.suffix.lower() in MODEL_SUFFIXES:
        return path.is_file()
    if path.suffix.lower() != ".npz":
        return False
    try:
        return kind_of_arrays(array_names(path)) == "body model"
    except InputError:
        return False


@reader_of("a body model")
def read_model_file(path: str | Path, **options: Any) -> BodyModel:
    """Read a body model with the options of `read_body_model`. Raises `InputError`."""
    suffix = Path(path).suffix.lower()
    if suffix == ".pt":
        return read_mhr(path, **options)
    if is_own_model(path):
        return read_own_model(path, **options)
    if suffix != ".pkl":
        return read_body_model(path, **options)
    entries = read_pickled_arrays(Path(path), (*SMPL_ARRAYS, *SKEL_ARRAYS))
    if TREE in entries:
        return make_skel({name: entries[name] for name in SKEL_ARRAYS if name in entries}, path, **options)
    return make_smpl(
        filled_arrays({name: entries[name] for name in SMPL_ARRAYS if name in entries}), path, **options
    )
