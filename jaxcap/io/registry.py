"""Tables of readers and writers by file suffix.

A new format is one line here.
"""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax.numpy as jnp

from ..arguments import checked
from ..biomechanics.angles import JointAngles
from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..body.skin import RigidSkin
from ..errors import InputError
from ..observe.markers import MarkerFrames
from .angle_table import write_angle_storage, write_angle_table
from .archives.npz import load_body, load_format, load_skeleton, motion_of, save_motion, skeleton_of
from .body_models.model_file import is_body_model, read_model_file
from .gltf.gltf import write_gltf
from .gltf.gltf_document import SUFFIXES as GLTF_READ
from .gltf.gltf_document import has_skin, missing_skin_error, read_clip_names, read_document
from .gltf.gltf_reader import read_gltf, read_gltf_body
from .kinds import wrong_kind_error
from .markers.c3d import read_c3d_file, write_c3d
from .markers.marker_file import BODY_SIZE_RANGE, MarkerFile, check_marker_extent, select_subject
from .markers.marker_table import read_marker_table, write_marker_table
from .markers.trc import read_trc, write_trc
from .meshes.mesh import SUFFIXES, check_body_size, check_mesh, read_mesh
from .opensim.osim import read_osim
from .opensim.storage import SUFFIXES as STORAGE_SUFFIXES
from .opensim.storage import read_coordinates
from .skeletons.amass import is_amass, read_amass, write_amass
from .skeletons.amc import read_amc
from .skeletons.asf import read_asf
from .skeletons.bvh import read_bvh, write_bvh
from .skeletons.rig_files import find_rig_files
from .skeletons.skl import read_skl, write_skl
from .skeletons.vj import read_vj
from .skinned.clip import split_clip, suffix_of
from .usd.usd import SUFFIXES as USD_SUFFIXES
from .usd.usd import write_usd
from .usd.usd_reader import SUFFIXES as USD_READ
from .usd.usd_reader import read_usd_body

#: suffix -> function of (path, unit)
SKELETON_READERS: dict[str, Callable[[Path, Any], Skeleton]] = {
    ".skl": read_skl,
    ".bvh": lambda path, unit: read_bvh(path, unit)[0],
    ".asf": lambda path, unit: read_asf(path).skeleton,
    ".npz": lambda path, unit: read_amass(path)[0] if is_amass(path) else load_skeleton(path),
    ".amc": lambda path, unit: read_asf(_find_asf(path)).skeleton,
    ".osim": lambda path, unit: read_osim(path).model.skeleton,
    **dict.fromkeys(GLTF_READ, lambda path, unit: _read_gltf(path)[0]),
    **dict.fromkeys(USD_READ, lambda path, unit: read_usd_body(path)[0].skeleton),
}
SKELETON_WRITERS: dict[str, Callable[[Path, Skeleton, Any], None]] = {".skl": write_skl}
MOTION_READERS: dict[str, Callable[[Path, Any], tuple[Skeleton, Motion]]] = {
    ".bvh": read_bvh,
    ".amc": lambda path, unit: _read_acclaim(path),
    **dict.fromkeys(STORAGE_SUFFIXES, lambda path, unit: _read_coordinates(path)),
    ".npz": lambda path, unit: read_amass(path) if is_amass(path) else _read_npz_motion(path),
    **dict.fromkeys((*GLTF_READ, *USD_READ), lambda path, unit: _read_animation(path)),
}
MOTION_WRITERS: dict[str, Callable[[Path, Skeleton, Motion, Any], None]] = {
    ".bvh": write_bvh,
    ".npz": lambda path, skeleton, motion, unit: save_motion(path, motion, skeleton),
}
#: other conventions of an `.npz` than our own
NPZ_CONVENTIONS: dict[str, Callable[[Path, Skeleton, Motion], None]] = {"amass": write_amass}
#: writers of bodies with linear blend skinning, with an optional motion
BODY_WRITERS: dict[str, Callable[[Path, Body, Motion | None], None]] = {
    ".glb": write_gltf,
    **dict.fromkeys(USD_SUFFIXES, write_usd),
}
SKINNED_READERS: dict[str, Callable[[Path], tuple[Body, Motion | None]]] = {
    **dict.fromkeys(GLTF_READ, lambda path: read_gltf_body(split_clip(path)[0], clip=split_clip(path)[1])),
    **dict.fromkeys(USD_READ, read_usd_body),
}
#: suffixes of all body files, with those of meshes that need a skeleton
BODY_SUFFIXES = (".npz", *dict.fromkeys((*SKINNED_READERS, *SUFFIXES)))
#: these files give their unit themselves if `unit` is None
MARKER_READERS: dict[str, Callable[[Path, Any], MarkerFile]] = {
    ".c3d": read_c3d_file,
    ".trc": read_trc,
    ".csv": read_marker_table,
}
MARKER_WRITERS: dict[str, Callable[[Path, MarkerFrames, Any], None]] = {
    ".c3d": write_c3d,
    ".trc": write_trc,
    ".csv": write_marker_table,
}
#: formats of joint angles
ANGLE_WRITERS: dict[str, Callable[[Path, JointAngles, float], None]] = {
    ".csv": write_angle_table,
    **dict.fromkeys(STORAGE_SUFFIXES, write_angle_storage),
}
#: default unit of a format; the default of the others is metres
DEFAULT_UNITS = {".bvh": "cm"}


@checked
def read_skeleton(path: str | Path, unit: str | float | None = None) -> Skeleton:
    """Read a skeleton.

    Formats are `.skl`, `.bvh`, `.asf`, `.amc` with its `.asf`, `.osim`, a body or motion `.npz`, a skinned `.glb`,
    `.gltf` or USD, and a mesh with an `.skl` in its folder (`is_rigged`). `unit` is that of the file's
    lengths if the format does not specify it; the default is metres, and centimetres for BVH.

    **Raises:** `InputError` if the suffix is unknown or the file is invalid.
    """
    beside = find_rig_files(path) if is_rigged(path) else None
    path = path if beside is None else beside.skeleton
    return _lookup(SKELETON_READERS, path, "a skeleton")(Path(path), _unit(path, unit))


def write_skeleton(path: str | Path, skeleton: Skeleton, unit: str | float | None = None) -> None:
    """Write a skeleton as `.skl`; `unit` and errors as in `read_skeleton`."""
    _lookup(SKELETON_WRITERS, path, "skeletons", "written")(Path(path), skeleton, _unit(path, unit))


@checked
def read_motion(path: str | Path, unit: str | float | None = None) -> tuple[Skeleton, Motion]:
    """Read a motion with its skeleton; `unit` and errors as in `read_skeleton`.

    Formats are `.bvh`, `.npz` (ours, or AMASS with a skeleton), `.glb`, `.gltf`, USD, `.amc` with the `.asf` in its folder, and
    `.mot` or `.sto` with the `.osim` in its folder. `character.glb:Walk` selects the clip `Walk`; without a name the first clip is read.
    """
    return _lookup(MOTION_READERS, path, "a motion")(Path(path), _unit(path, unit))


@checked
def write_motion(
    path: str | Path, skeleton: Skeleton, motion: Motion, unit: str | float | None = None
) -> None:
    """Write a motion as `.bvh` or `.npz`; `unit` and errors as in `read_skeleton`."""
    _lookup(MOTION_WRITERS, path, "motions", "written")(Path(path), skeleton, motion, _unit(path, unit))


def write_body(path: str | Path, body: Body, motion: Motion | None = None) -> None:
    """Write a body with linear blend skinning as `.glb`, `.usda`, `.usdc` or `.usdz`.

    An optional motion becomes its animation. Convert other bodies by `jaxcap.edit.to_linear_blend` first.

    **Raises:** `InputError` as `write_gltf` and `write_usd` do.
    """
    _lookup(BODY_WRITERS, path, "skinned bodies", "written")(Path(path), body, motion)


@checked
def read_skinned(path: str | Path) -> tuple[Body, Motion | None]:
    """Read a body with linear blend skinning, and its motion if there is one.

    Formats are skinned `.glb`, `.gltf` and USD; clips are selected as in `read_motion`.

    **Raises:** `InputError` as `read_gltf_body` and `read_usd_body` do.
    """
    return _lookup(SKINNED_READERS, path, "a skinned body")(Path(path))


def is_skinned(path: str | Path) -> bool:
    """Check that a file has a skin for `read_skinned`: a `.glb` or `.gltf` may be a mesh only."""
    file, suffix = split_clip(path)[0], suffix_of(path)
    return suffix in SKINNED_READERS and (suffix not in GLTF_READ or has_skin(file))


def is_rigged(path: str | Path) -> bool:
    """Check that a file is an unskinned mesh with a skeleton and parts of the same name, for `read_body`."""
    return suffix_of(path) in SUFFIXES and not is_skinned(path) and find_rig_files(path) is not None


def list_clips(path: str | Path) -> tuple[str, ...]:
    """Return the names of the clips in a file, which `path:NAME` selects; empty for other formats."""
    return read_clip_names(split_clip(path)[0]) if suffix_of(path) in GLTF_READ else ()


def default_clip_message(path: str | Path) -> str | None:
    """Return a sentence on the clip that is read by default; None if there is no choice.

    There is a choice if a file has several clips and `path` names none.
    """
    clips = list_clips(path)
    if len(clips) < 2 or split_clip(path)[1] is not None:
        return None
    return (
        f"{path}: the file contains {len(clips)} clips, {', '.join(clips)}; '{clips[0]}' is read; select another one "
        f"with a colon, as in {path}:{clips[1]}"
    )


def read_body(
    path: str | Path,
    skeleton: str | Path | None = None,
    parts: str | Path | None = None,
    unit: str | float = "m",
) -> Body:
    """Read a body from one file, or from a mesh with a skeleton (`.skl`) and parts (`.vj`).

    One file is an `.npz`, a body model, of which the template is taken (`read_body_model`, `read_mhr`), or a skinned
    `.glb`, `.gltf` or USD. The vertices of a mesh with parts move rigidly
    with their bones (Kineben, section 4.2). Files in the folder of the mesh that have its name are found
    without being given. `unit` is that of mesh and skeleton.

    **Raises:** `InputError` if a file is invalid or missing, if the mesh cannot be a body surface, or if it
    does not have the size of a body.
    """
    file, suffix = split_clip(path)[0], suffix_of(path)
    if is_body_model(file):
        return read_model_file(file).template
    if suffix == ".npz":
        return load_body(file)
    if skeleton is None and is_skinned(path):
        return read_skinned(path)[0]
    if suffix not in SUFFIXES:
        raise wrong_kind_error(path, "a body", BODY_SUFFIXES)
    if skeleton is None and parts is None and (beside := find_rig_files(file)):
        skeleton, parts = beside
    if skeleton is None and file.is_file() and suffix in GLTF_READ:
        # errors of the file itself come first
        read_document(file)
        raise missing_skin_error(file)
    if skeleton is None or parts is None:
        raise InputError(
            f"{path}: this is a mesh without a rig; expected a skeleton (.skl) and the joint of each vertex (.vj); give "
            f"these files, or rig the mesh with `jaxcap rig {path} -o body.npz`."
        )
    mesh = read_mesh(file, unit)
    check_mesh(mesh, path)
    check_body_size(float((mesh.vertices.max(0) - mesh.vertices.min(0)).max()), path, unit)
    tree = read_skeleton(skeleton, unit)
    bones = read_vj(parts, tree, len(mesh.vertices))
    return Body(tree, RigidSkin(jnp.asarray(bones)), jnp.asarray(mesh.vertices), jnp.asarray(mesh.faces))


@checked
def read_markers(
    path: str | Path,
    unit: str | float | None = None,
    *,
    subject: str | None = None,
    size: tuple[float, float] = BODY_SIZE_RANGE,
) -> MarkerFrames:
    """Read marker trajectories from `.c3d`, `.trc` or `.csv`; gaps are not visible.

    **Arguments:** `unit` of the file's lengths, which overrides that of the file; if neither is given, C3D
    and TRC are in millimetres and CSV is in metres. `subject` whose markers are read, by the prefix of their
    labels (`Anna:LKNE`), if there is more than one. `size`, lower and upper bound in metres of the longest
    side of the markers of a frame.

    **Raises:** `InputError` with one sentence if the suffix is unknown, if the file is invalid, damaged or
    cut short, if it has no markers, no frames or no visible marker, or if it has several subjects and none is
    selected; also if the markers have another size, as with a wrong unit. The message then names the likely
    unit.
    """
    path = Path(path)
    return _select_frames(read_marker_file(path, unit), path, subject, size)


@checked
def read_c3d(
    path: str | Path,
    unit: str | float | None = None,
    *,
    subject: str | None = None,
    size: tuple[float, float] = BODY_SIZE_RANGE,
) -> MarkerFrames:
    """Read marker trajectories from a C3D file, whatever its suffix; arguments and errors are those of
    `read_markers`."""
    path = Path(path)
    return _select_frames(read_c3d_file(path, unit), path, subject, size)


def _select_frames(
    file: MarkerFile, path: Path, subject: str | None, size: tuple[float, float]
) -> MarkerFrames:
    frames = select_subject(file.frames, path, subject)
    frames, left_out = check_marker_extent(frames, path, file.scale, size)
    for sentence in left_out:
        warnings.warn(f"{path}: {sentence}", stacklevel=5)
    return frames


@checked
def read_marker_file(path: str | Path, unit: str | float | None = None) -> MarkerFile:
    """Read all subjects of a marker file, whatever their size, and its metadata.

    `unit` and other errors are as in `read_markers`.
    """
    return _lookup(MARKER_READERS, path, "a marker file")(Path(path), unit)


@checked
def write_markers(path: str | Path, frames: MarkerFrames, unit: str | float | None = None) -> None:
    """Write markers or joint centres as `.c3d`, `.trc` or `.csv`.

    The default `unit` is millimetres, and metres for `.csv`.

    **Raises:** `InputError` if the suffix is unknown, the format cannot represent the markers, or the file
    cannot be written.
    """
    suffix = Path(path).suffix.lower()
    write = _lookup(MARKER_WRITERS, path, "markers", "written")
    write(Path(path), frames, ("m" if suffix == ".csv" else "mm") if unit is None else unit)


@checked
def write_angles(path: str | Path, angles: JointAngles, start: float = 0.0) -> None:
    """Write the joint angles of a motion as `.csv`, in degrees, with their conventions as comments, or as a table of OpenSim, `.mot` or
    `.sto`; the first frame is at `start`, seconds.

    **Raises:** `InputError` if the suffix is unknown, the angles are those of a single pose, or the file cannot be
    written.
    """
    _lookup(ANGLE_WRITERS, path, "joint angles", "written")(Path(path), angles, start)


def _lookup(table: dict[str, Any], path: str | Path, content: str, action: str = "") -> Any:
    """Return the table entry of a suffix.

    For errors, `content` is read, as in "a motion", or `action` to it, as in "motions are not written".
    """
    suffix = suffix_of(path)
    if suffix not in table:
        if not action:
            raise wrong_kind_error(path, content, tuple(table))
        raise InputError(f"{path}: {content} are not {action} as '{suffix}' files; use {', '.join(table)}.")
    return table[suffix]


def _unit(path: str | Path, unit: str | float | None) -> str | float:
    return DEFAULT_UNITS.get(Path(path).suffix.lower(), "m") if unit is None else unit


def _read_gltf(path: Path) -> tuple[Skeleton, Motion | None]:
    file, clip = split_clip(path)
    return read_gltf(file, clip=clip)


def _read_animation(path: Path) -> tuple[Skeleton, Motion]:
    if suffix_of(path) in GLTF_READ:
        skeleton, motion = _read_gltf(path)
    else:
        body, motion = read_skinned(path)
        skeleton = body.skeleton
    if motion is None:
        raise InputError(f"{path}: the file contains no animation; export it with its animation.")
    return skeleton, motion


def _read_npz_motion(path: Path) -> tuple[Skeleton, Motion]:
    arrays = load_format(path, "jaxcap motion")
    if "names" not in arrays:
        raise InputError(f"{path}: this motion was saved without its skeleton; save it with its skeleton.")
    return skeleton_of(arrays, path), motion_of(arrays, path)


def _read_acclaim(path: Path) -> tuple[Skeleton, Motion]:
    asf = read_asf(_find_asf(path))
    return asf.skeleton, read_amc(path, asf)


def _read_coordinates(path: Path) -> tuple[Skeleton, Motion]:
    """Read coordinates of OpenSim with the model in the same folder."""
    model = read_osim(_find_osim(path)).model
    return model.skeleton, read_coordinates(path, model)[1]


def _find_osim(path: Path) -> Path:
    """Find the model of a motion: the only one in its folder."""
    fits = sorted(path.parent.glob("*.osim")) if path.parent.is_dir() else []
    if len(fits) != 1:
        raise InputError(
            f"{path}: the folder has {len(fits)} OpenSim models (.osim); expected one, the model of this motion; or give it with "
            "--body in `jaxcap convert`."
        )
    return fits[0]


def _find_asf(path: Path) -> Path:
    """Find the skeleton of a motion in the same folder: the longest name that begins the motion's name.

    An example is `02.asf` for `02_05.amc`.
    """
    folder = path.parent
    fits = [asf for asf in folder.glob("*.asf") if path.stem.startswith(asf.stem)] if folder.is_dir() else []
    if not fits:
        raise InputError(
            f"{path}: the skeleton of this motion is missing; copy its .asf file into the same folder, with a name such as "
            f"{path.stem}.asf."
        )
    return max(fits, key=lambda found: len(found.stem))
