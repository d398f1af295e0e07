"""The conversions of `jaxcap convert` by suffixes, and their options."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from ...errors import InputError
from ...io.body_models.model_file import MODEL_SUFFIXES
from ...io.foreign import UNSUPPORTED_FORMATS, WRITABLE_ALTERNATIVES
from ...io.kinds import identify, wrong_kind_error
from ...io.meshes.mesh import SUFFIXES
from ...io.meshes.mesh import WRITABLE_SUFFIXES as MESH_WRITTEN
from ...io.opensim.storage import SUFFIXES as STORAGE_SUFFIXES
from ...io.registry import (
    ANGLE_WRITERS,
    BODY_WRITERS,
    MARKER_READERS,
    MARKER_WRITERS,
    MOTION_READERS,
    MOTION_WRITERS,
    SKELETON_READERS,
    SKELETON_WRITERS,
    SKINNED_READERS,
    is_rigged,
    is_skinned,
)
from ...io.skinned.clip import suffix_of
from ...io.system.paths import numbered_path

ConversionKind = Literal[
    "own", "body", "motion", "points", "markers", "mesh", "surface", "skeleton", "angles"
]
#: purpose of each option, and the conversions that take it
PURPOSES: dict[str, tuple[str, tuple[ConversionKind, ...]]] = {
    "motion": ("bodies that are written as .glb, USD or meshes", ("body", "surface")),
    "body": ("motions of a body", ("body", "motion", "points", "surface", "angles")),
    "as amass": ("motions that are written as .npz", ("motion",)),
    "as angles": ("joint angles of motions", ("angles",)),
    "as body": ("bodies that are written as .npz", ("own",)),
    "as smpl": ("bodies that are written as .npz", ("own",)),
    "vertices": ("motions that are written as .trc, .c3d or .csv", ("points",)),
    "up": ("motions in AMASS format", ("body", "motion", "points", "surface", "angles")),
    "rate": ("motions in AMASS format", ("body", "motion", "points", "surface", "angles")),
    "tolerance": ("bodies that are written as .glb or USD", ("body",)),
    "influences": ("bodies that are written as .glb or USD", ("body",)),
}
#: suffixes of the targets that `--as` writes
SUFFIXES_OF_CONTENT: dict[str, tuple[str, ...]] = {
    "as amass": (".npz",),
    "as angles": tuple(ANGLE_WRITERS),
    "as body": (".npz",),
    "as smpl": (".npz",),
}
#: suffixes of files in metres, or with a unit
KNOWN_UNIT_SUFFIXES = (".npz", *SKINNED_READERS, ".asf", ".amc")


#: all suffixes of target files
WRITTEN = {
    *BODY_WRITERS,
    *MOTION_WRITERS,
    *MARKER_WRITERS,
    *ANGLE_WRITERS,
    *SKELETON_WRITERS,
    *MESH_WRITTEN,
}


def find_conversion(
    source: Path, target: Path, human: bool = False, with_body: bool = False, with_motion: bool = False
) -> ConversionKind:
    """Choose the conversion by the suffixes; `human`, whether the source is the embedded body, `with_body`, whether the body of a
    motion is given, and `with_motion`, whether the motion of a body is. Raises `InputError` if there is none."""
    here, there = ".npz" if human else suffix_of(source), target.suffix.lower()
    if there not in WRITTEN and there in WRITABLE_ALTERNATIVES:
        raise InputError(
            f"{target}: '{there}' files cannot be written; write {WRITABLE_ALTERNATIVES[there]}."
        )
    if human and there not in (*BODY_WRITERS, *MESH_WRITTEN):
        raise InputError(
            f"{source}: the embedded body cannot be converted to {_files(there)}; write it as "
            f"{', '.join(dict.fromkeys((*BODY_WRITERS, '.npz', *MESH_WRITTEN)))}."
        )
    if there in BODY_WRITERS and (
        here in (".npz", *MODEL_SUFFIXES)
        or is_skinned(source)
        or is_rigged(source)
        or (with_body and here in MOTION_READERS)
    ):
        return "body"
    if there in MESH_WRITTEN and (
        (with_body and here in MOTION_READERS)
        or human
        or (here in (".npz", *MODEL_SUFFIXES) and identify(source) in ("body", "body model"))
        # a single mesh of such a file is the mesh as it is there
        or (
            (with_motion or numbered_path(target, 0) is not None)
            and (is_skinned(source) or is_rigged(source))
        )
    ):
        return "surface"
    if there in MESH_WRITTEN and identify(source) in ("motion", "amass"):
        raise InputError(
            f"{source}: a motion has no surface to write as {_files(there)}; give its body with --body."
        )
    if here in SUFFIXES and there in MESH_WRITTEN:
        return "mesh"
    if here in MOTION_READERS and there in MOTION_WRITERS:
        return "motion"
    if here in MOTION_READERS and there in MARKER_WRITERS:
        return "points"
    if here in STORAGE_SUFFIXES and there in STORAGE_SUFFIXES:
        raise InputError(
            f"{target}: coordinates of an OpenSim model are not converted to other coordinates; --as angles writes the joint angles of the "
            "motion by ISB's conventions."
        )
    if here in MOTION_READERS and there in ANGLE_WRITERS:
        return "angles"
    if here in MARKER_READERS and there in MARKER_WRITERS:
        return "markers"
    if here in SKELETON_READERS and there in SKELETON_WRITERS:
        return "skeleton"
    if source.is_dir() or not here or here in UNSUPPORTED_FORMATS or identify(source) is None:
        raise wrong_kind_error(
            source, "something to convert", (*MOTION_READERS, *SKELETON_READERS, *MARKER_READERS, *SUFFIXES)
        )
    raise InputError(
        f"{source}: '{here}' files cannot be converted to {_files(there)}; motions are read from "
        f"{', '.join(MOTION_READERS)} and written as {', '.join(MOTION_WRITERS)}, their joint centres as {', '.join(MARKER_WRITERS)}, skeletons as .skl, "
        f"bodies as {', '.join(BODY_WRITERS)} and with --as body as .npz, meshes as {', '.join(MESH_WRITTEN)}."
    )


def _files(suffix: str) -> str:
    return f"'{suffix}' files" if suffix else "a file without a suffix"


def check_options(kind: ConversionKind, target: Path, options: Mapping[str, Any]) -> None:
    """Check that the given options, by their names in `PURPOSES` (None, empty, or False if not given), apply
    to the conversion. Raises `InputError`."""
    for name, (purpose, ways) in PURPOSES.items():
        if options[name] and kind not in ways:
            raise InputError(f"{target}: --{name} is for {purpose}.")
        suffixes = SUFFIXES_OF_CONTENT.get(name, ())
        if options[name] and suffixes and target.suffix.lower() not in suffixes:
            written = " or ".join(suffixes)
            raise InputError(
                f"{target}: --{name} is written as {written}; give a name that ends in {written}."
            )
    if options["vertices"] and options["body"] is None:
        raise InputError(f"{target}: --vertices needs a body; give it with --body.")


def check_units(
    kind: ConversionKind, source: Path, target: Path, unit: str | None, target_unit: str | None
) -> None:
    """Check that units are given only for files without their own. Raises `InputError`."""
    if unit and kind != "mesh" and suffix_of(source) in KNOWN_UNIT_SUFFIXES:
        raise InputError(f"{source}: '{suffix_of(source)}' files have a known unit; omit --unit {unit}.")
    if target_unit and kind == "angles":
        raise InputError(f"{target}: joint angles are written in degrees; omit --target-unit {target_unit}.")
    if target_unit and kind != "mesh" and target.suffix.lower() in (".npz", *BODY_WRITERS):
        raise InputError(
            f"{target}: '{target.suffix}' files are written in metres; omit --target-unit {target_unit}."
        )
