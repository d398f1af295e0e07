"""Body models in files of any family that is read."""

from pathlib import Path
from typing import Any

from ...body.body_model import BodyModel
from ...errors import InputError
from ..archives.archive import array_names
from ..kinds import kind_of_arrays
from .mhr import read_mhr
from .skel import is_skel, read_skel
from .smpl import read_body_model

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


def read_model_file(path: str | Path, **options: Any) -> BodyModel:
    """Read a body model with the options of `read_body_model`. Raises `InputError`."""
    suffix = Path(path).suffix.lower()
    if suffix == ".pt":
        return read_mhr(path, **options)
    read = read_skel if suffix == ".pkl" and is_skel(path) else read_body_model
    return read(path, **options)
