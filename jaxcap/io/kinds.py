"""Detection of the content type of a file or folder, and errors for files of the wrong type."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from .archives.archive import array_lengths, array_names, read_format_name
from .depth.camera_keys import list_intrinsics
from .depth.images import DEPTH_ARRAYS, is_depth_image
from .depth.open_exr import EXR_SUFFIX
from .depth.recording import RECORDING_SUFFIXES
from .foreign import IMAGE_SUFFIXES, UNSUPPORTED_FORMATS
from .gltf.gltf_document import SUFFIXES as GLTF
from .gltf.gltf_document import has_skin
from .skeletons.parameters.arrays import BODY_KEYS, is_motion
from .skeletons.rig_files import find_rig_files
from .skinned.clip import split_clip
from .text import read_json, shortened

#: the name of each type in a sentence
KIND_NAMES = {
    "body": "a body",
    "body model": "a body model",
    "motion": "a motion",
    "amass": "a motion in AMASS format",
    "subject": "a subject with its markers",
    "limits": "a file of joint limits",
    "prior": "a pose prior",
    "checkpoint": "a checkpoint of an unfinished run",
    "keys": "a file of keys",
    "meshes": "a file of registered meshes",
    "clouds": "a file of point clouds",
    "joints": "a file of joint centres",
    "arrays": "an .npz file with unknown arrays",
    "damaged": "an incomplete or damaged .npz file",
    "skinned": "a skinned body",
    "usd": "a USD file",
    "mesh": "a mesh or a cloud",
    "rigged": "a mesh with its skeleton (.skl) and parts (.vj)",
    "bvh": "a motion with its skeleton (BVH)",
    "asf": "a skeleton with joint limits (ASF)",
    "amc": "a motion (AMC)",
    "osim": "an OpenSim model (.osim)",
    "storage": "a table over time of OpenSim",
    "skl": "a Kineben skeleton (.skl)",
    "cst": "a file of Kineben joint limits (.cst)",
    "vj": "a file with the joint of each vertex (.vj)",
    "markers": "a marker file",
    "statistics": "the statistics of a tracking run",
    "cameras": "a file of camera calibrations",
    "constraints": "a file of constraints for `jaxcap ik`",
    "scan": "the settings of a scan",
    "joint names": "a table of matching joints",
    "json": "a JSON file of unknown content",
    "text": "a text file",
    "journal": "the journal of a tracking run",
    "run": "the folder of a tracking run",
    "scans": "a folder of scans",
    "folder": "a folder",
    "depth": "a depth image",
    "picture": "an image or a document",
}
#: the plurals of `KIND_NAMES`
KIND_PLURALS = {
    "body": "bodies",
    "body model": "body models",
    "motion": "motions",
    "amass": "motions in AMASS format",
    "subject": "subjects with their markers",
    "limits": "files of joint limits",
    "prior": "pose priors",
    "checkpoint": "checkpoints of unfinished runs",
    "keys": "files of keys",
    "meshes": "files of registered meshes",
    "clouds": "files of point clouds",
    "joints": "files of joint centres",
    "arrays": ".npz files with unknown arrays",
    "damaged": "incomplete or damaged .npz files",
    "skinned": "skinned bodies",
    "usd": "USD files",
    "mesh": "meshes or clouds",
    "rigged": "meshes with their skeletons (.skl) and parts (.vj)",
    "joint names": "tables of matching joints",
    "bvh": "motions with their skeletons (BVH)",
    "asf": "skeletons with joint limits (ASF)",
    "amc": "motions (AMC)",
    "osim": "OpenSim models (.osim)",
    "storage": "tables over time of OpenSim",
    "skl": "Kineben skeletons (.skl)",
    "cst": "files of Kineben joint limits (.cst)",
    "vj": "files with the joint of each vertex (.vj)",
    "markers": "marker files",
    "statistics": "statistics of tracking runs",
    "cameras": "files of camera calibrations",
    "constraints": "files of constraints for `jaxcap ik`",
    "scan": "settings of scans",
    "json": "JSON files of unknown content",
    "text": "text files",
    "journal": "journals of tracking runs",
    "run": "folders of tracking runs",
    "scans": "folders of scans",
    "folder": "folders",
    "depth": "depth images",
    "picture": "images or documents",
}
#: commands that write the formats of an `.npz`
WRITERS = {
    "body": "`jaxcap rig`, `learn` or `adapt`",
    "body model": "`jaxcap learn --people`",
    "motion": "`jaxcap track`, `fit` or `adapt`",
    "subject": "`jaxcap markers fit`",
    "limits": "`jaxcap limits learn`",
    "prior": "`jaxcap prior learn`",
    "checkpoint": "`jaxcap learn` or `adapt`",
    "keys": "`jaxcap edit keys`",
}
#: the array of a content that has a row for each of its frames, vertices, ..., and the singular and plural of these
_COUNTED = {
    "body": ("vertices", "vertex", "vertices"),
    "body model": ("v_template", "vertex", "vertices"),
    "motion": ("rotations", "frame", "frames"),
    "amass": ("poses", "frame", "frames"),
    "subject": ("marker.labels", "marker", "markers"),
    "limits": ("joints", "joint", "joints"),
    "joints": ("joints", "frame", "frames"),
}
#: functions that read an `.npz` of another function's content
_READERS = {"amass": "io.read_amass", "body model": "read_body_model"}
#: names of formats in an `.npz`
_FORMATS = ("body", "body model", "motion", "subject", "limits", "prior", "checkpoint", "keys", "meshes")
#: suffixes of files of arrays
_ARCHIVE_SUFFIXES = (".npz", ".partial")
_SUFFIXES = {
    ".bvh": "bvh",
    ".asf": "asf",
    ".amc": "amc",
    ".osim": "osim",
    ".mot": "storage",
    ".sto": "storage",
    ".skl": "skl",
    ".cst": "cst",
    ".vj": "vj",
    ".pkl": "body model",
    ".pt": "body model",
    ".c3d": "markers",
    ".trc": "markers",
    ".csv": "markers",
    ".txt": "text",
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), "usd"),
    **dict.fromkeys((".off", ".obj", ".ply", ".stl", ".pcd", ".xyz"), "mesh"),
    **dict.fromkeys((EXR_SUFFIX, *RECORDING_SUFFIXES), "depth"),
    **dict.fromkeys(IMAGE_SUFFIXES, "picture"),
}


def identify(path: str | Path) -> str | None:
    """Return the content type of a file or folder, a key of `KIND_NAMES`.

    The type follows from the suffix, the first bytes and the names inside; nothing else is checked. None if
    the type is unknown or the file does not exist.
    """
    path = split_clip(path)[0]
    suffix = path.suffix.lower()
    if path.is_dir():
        return _folder(path)
    if not path.is_file():
        return None
    if path.name == "journal":
        return "journal"
    if path.name == "statistics.csv":
        return "statistics"
    if suffix in GLTF and has_skin(path):
        return "skinned"
    if suffix in _ARCHIVE_SUFFIXES:
        return _npz(path)
    if is_depth_image(path):
        return "depth"
    kind = _json(path) if suffix == ".json" else "mesh" if suffix in GLTF else _SUFFIXES.get(suffix)
    return "rigged" if kind == "mesh" and find_rig_files(path) else kind


def kind_of_arrays(names: Iterable[str], format_name: str = "") -> str:
    """Return the content type of an `.npz` from the names of its arrays and of its format."""
    found = set(names)
    if format_name.removeprefix("jaxcap ") in _FORMATS:
        return format_name.removeprefix("jaxcap ")
    if {"modes.centres", "modes.vertices", "template_coefficients"} <= found:
        return "body model"
    if "skin" in found:
        # a body without the name of its format
        return "arrays"
    if {"v_template", "shapedirs", "J_regressor"} <= found:
        return "body model"
    # files of depth, clouds and meshes may have the poses of cameras and a rate
    others = found & {*DEPTH_ARRAYS, "points"} or {"vertices", "faces"} <= found
    if is_motion(found) and (not others or found & BODY_KEYS):
        return "amass"
    if found & set(DEPTH_ARRAYS):
        return "depth"
    if "joints" in found and "points" not in found:
        return "joints"
    if "vertices" in found and {"faces", "face_counts"} & found:
        return "meshes"
    return "clouds" if {"points", "vertices"} & found else "arrays"


def wrong_kind_error(path: str | Path, expected: str, suffixes: Sequence[str]) -> InputError:
    """Return the error for a file that is not `expected`, as in "a motion", for readers of some suffixes.

    The message gives the actual type of the file, if it is known, and advice.
    """
    path = split_clip(path)[0]
    suffix, known = path.suffix.lower(), ", ".join(suffixes)
    if path.is_dir():
        return InputError(f"{path}: this is a folder; expected {expected}; {_folder_hint(path, suffixes)}.")
    if not path.exists():
        if path.name.split(":")[0] == "human":
            return InputError(
                f"{path}: this is the embedded body; expected {expected} ({known}); write the body to a file with "
                f"`jaxcap convert {path} body.npz`."
            )
        return InputError(f"{path}: there is no such file; check the path.")
    if suffix in UNSUPPORTED_FORMATS:
        what, instead = UNSUPPORTED_FORMATS[suffix]
        return InputError(f"{path}: this is {what}, which is not read; {instead}.")
    kind = identify(path)
    if kind is None:
        named = f"the suffix '{path.suffix}' is unknown" if suffix else "the name has no suffix"
        return InputError(f"{path}: {named}; expected {expected}: {known}.")
    return InputError(f"{path}: this is {KIND_NAMES[kind]}; expected {expected}: {known}; {info_hint(path)}.")


def check_kind(path: str | Path, kind: str, suffixes: Sequence[str]) -> None:
    """Check that a file is not clearly of another type than `kind`, a key of `KIND_NAMES`.

    This is for formats that are read under any file name. Raises `InputError`.
    """
    path = Path(path)
    if (
        path.is_dir()
        or path.suffix.lower() in UNSUPPORTED_FORMATS
        or identify(path) not in (kind, "text", "json", None)
    ):
        raise wrong_kind_error(path, KIND_NAMES[kind], suffixes)


def check_npz(path: str | Path, expected: str) -> None:
    """Check that a file is not clearly another type of file than an `.npz`. Raises `InputError`."""
    path = Path(path)
    suffix = path.suffix.lower()
    if (
        path.is_dir()
        or suffix in UNSUPPORTED_FORMATS
        or (suffix not in _ARCHIVE_SUFFIXES and identify(path) is not None)
    ):
        raise wrong_kind_error(path, expected, (".npz",))


def wrong_arrays_error(path: str | Path, expected: str) -> InputError:
    """Return the error for an `.npz` that is not `expected`, as in "a body".

    The message gives the type and the size of the content, and advice; if the type is unknown, the names of the
    arrays.
    """
    names = array_names(path)
    kind = kind_of_arrays(names, read_format_name(path))
    what = KIND_NAMES[kind] + _format_size(path, kind)
    if kind == "arrays":
        there = ", ".join(map(shortened, names[:8])) + (", ..." if len(names) > 8 else "")
        what += f" ({there or 'none'})"
    reader = f"; in Python jaxcap.{_READERS[kind]} reads it" if kind in _READERS else ""
    return InputError(f"{path}: this is {what}; expected {expected}; {info_hint(path)}{reader}.")


def describe_formats(kinds: Sequence[str]) -> str:
    """Describe the types of files that a reader accepts, each with the commands that write it."""
    names = [f"{KIND_NAMES[kind]} (from {WRITERS[kind]})" for kind in kinds]
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _format_size(path: str | Path, kind: str) -> str:
    """Format the size of the content of an `.npz`, as in " (40 frames)"; empty if it is not known."""
    if kind not in _COUNTED:
        return ""
    array, one, several = _COUNTED[kind]
    try:
        count = array_lengths(path, (array,)).get(array)
    except InputError:
        return ""
    return "" if count is None else f" ({count} {one if count == 1 else several})"


def info_hint(path: str | Path) -> str:
    """Return a sentence on how to find the purpose of a file."""
    return f"`jaxcap info {shlex.quote(str(path))}` describes its use"


def _folder_hint(folder: Path, suffixes: Sequence[str]) -> str:
    """Return advice for a user who gave a folder instead of a file."""
    fits = sorted({p.suffix.lower() for p in folder.iterdir() if p.suffix.lower() in suffixes})
    if fits:
        return f"give the files in it, such as {shlex.quote(str(folder))}/*{fits[0]}"
    return f"give a file ({', '.join(suffixes)}), as the folder contains none"


def _npz(path: Path) -> str:
    try:
        return kind_of_arrays(array_names(path), read_format_name(path))
    except InputError:
        return "damaged"


def kind_of_json(content: Any) -> str:
    """Return the content type of the data of a JSON file."""
    if list_intrinsics(content):
        return "cameras"
    if not isinstance(content, Mapping):
        return "json"
    formats = {"jaxcap constraints": "constraints", "jaxcap joint names": "joint names"}
    form = content.get("format")
    if isinstance(form, str) and form in formats:
        return formats[form]
    kinds = {
        "cameras": "cameras",
        "constraints": "constraints",
        "body arrays": "scan",
        "joints": "keys",
    }
    found = next((kind for name, kind in kinds.items() if name in content), None)
    if found == "keys" and "rate" not in content:
        found = None
    if found is None and {"rate", "frames"} <= content.keys():
        return "statistics"
    if (
        found is None
        and content
        and form is None
        and all(isinstance(v, str | None) for v in content.values())
    ):
        return "joint names"
    return found or "json"


def _json(path: Path) -> str:
    try:
        return kind_of_json(read_json(path))
    except InputError:
        return "json"


def _folder(folder: Path) -> str:
    if any((folder / name).is_file() for name in ("motion.npz", "statistics.json", "journal")):
        return "run"
    return "scans" if (folder / "cameras.json").is_file() else "folder"
