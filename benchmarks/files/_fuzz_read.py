"""Read one file with the readers of its format, and classify the outcome."""

import dataclasses
import functools
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.files._fuzz_seeds import ASF, HEADER, fuzz_body
from jaxcap.body.body import Body
from jaxcap.cli.adapt.state import restore_state
from jaxcap.cli.edit.pairs import parse_point_pair, read_pair_table
from jaxcap.cli.learn.state import restore_state as learn_state_of
from jaxcap.cli.scan.folder import check_same_scans
from jaxcap.errors import InputError
from jaxcap.io.archives.checkpoint import load_checkpoint, load_progress
from jaxcap.io.archives.journal import read_header, read_records, resume_journal
from jaxcap.io.archives.limits import load_limits, read_limits
from jaxcap.io.archives.npz import load_body_limits, load_skeleton
from jaxcap.io.archives.prior import load_priors, load_shape_prior, shape_prior_size
from jaxcap.io.archives.run_statistics import read_statistics
from jaxcap.io.body_models.learned import read_model_people
from jaxcap.io.body_models.mhr import read_mhr
from jaxcap.io.body_models.skel import read_skel
from jaxcap.io.body_models.smpl import read_body_model
from jaxcap.io.cameras import read_cameras
from jaxcap.io.constraints import read_constraints
from jaxcap.io.gltf.gltf_reader import read_gltf
from jaxcap.io.markers.marker_corrections import read_corrections
from jaxcap.io.markers.subject import load_subject
from jaxcap.io.meshes.clouds import read_clouds
from jaxcap.io.meshes.colours import read_colours
from jaxcap.io.meshes.mesh import read_mesh
from jaxcap.io.meshes.meshes import read_meshes
from jaxcap.io.meshes.vertex_list import read_vertex_list
from jaxcap.io.opensim.osim import read_osim
from jaxcap.io.opensim.storage import read_storage
from jaxcap.io.opensim.tasks import read_ik_tasks
from jaxcap.io.registry import (
    is_skinned,
    read_body,
    read_marker_file,
    read_motion,
    read_skeleton,
    read_skinned,
)
from jaxcap.io.skeletons.amass import read_amass
from jaxcap.io.skeletons.amc import read_amc
from jaxcap.io.skeletons.asf import read_asf
from jaxcap.io.skeletons.body_motion import read_body_motion
from jaxcap.io.skeletons.cst import read_cst
from jaxcap.io.skeletons.vj import read_vj
from jaxcap.view.load import load

#: what reading a file may end in, best first; the last five are faults
OUTCOMES = (
    "data",
    "refused",
    "last door",
    "not finite",
    "foreign words",
    "traceback",
    "too much memory",
    "too slow",
    "crash",
)
#: those that must not be
FAULTS = OUTCOMES[3:]


def outcome(format: str, path: Path) -> tuple[str, str]:
    """Return the worst of `OUTCOMES` among all readers of a format, without memory and time, and its details."""
    found = [_outcome(reader, path) for reader in READERS[format]]
    return max(found, key=lambda one: OUTCOMES.index(one[0]))


def _outcome(reader: Callable[[Path], Any], path: Path) -> tuple[str, str]:
    strange: list[warnings.WarningMessage] = []
    try:
        # a warning of ours is as good as a sentence, also where a run of tests makes errors of them; one of NumPy is not
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            try:
                found = reader(path)
            finally:
                strange = [one for one in told if issubclass(one.category, RuntimeWarning)]
        if strange:
            return "foreign words", _describe_warning(strange[0])
        for where, values in iterate_arrays(found):
            if not np.isfinite(values).all():
                return "not finite", where
    except InputError as error:
        return ("foreign words", _describe_warning(strange[0])) if strange else _classify_error(error, path)
    except MemoryError as error:
        return "too much memory", _error_location(error)
    except Exception as error:
        return "traceback", _error_location(error)
    return "data", ""


def _describe_warning(warning: warnings.WarningMessage) -> str:
    return f"warning: {warning.message} at {Path(warning.filename).name}:{warning.lineno}"


def _classify_error(error: InputError, path: Path) -> tuple[str, str]:
    """Test if an error is a sentence of the library: it names the file, ends with a full stop, and does not repeat another
    library's error."""
    text = str(error)
    context: BaseException | None = error.__cause__ or error.__context__
    said = text.removeprefix(str(path)).lstrip(":0123456789 ")
    foreign = (
        context is not None
        and not isinstance(context, InputError)
        and str(context)
        and said.startswith(str(context))
    )
    if foreign and isinstance(context, ValueError) and is_raised_by_library(context):
        foreign = False
    if path.name not in text or not text.endswith((".", ".)")) or foreign or len(text) > 2000:
        return "foreign words", text[:300]
    return ("last door" if error.__cause__ is not None else "refused"), text[:300]


def is_raised_by_library(error: BaseException) -> bool:
    """Test if a statement of the library raised an error, by the text of the line."""
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return "jaxcap" in Path(frame.filename).parts and (frame.line or "").startswith("raise ")


def _error_location(error: BaseException) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "jaxcap" in Path(frame.filename).parts] or frames[-1:]
    return f"{type(error).__name__}: {str(error)[:120]} at {Path(own[-1].filename).name}:{own[-1].lineno}"


def iterate_arrays(value: Any, where: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """Yield every array of floats in the result of a reader, with its path."""
    if isinstance(value, float | np.floating):
        yield where, np.asarray(value)
    elif isinstance(value, str | bytes | int | None):
        return
    elif isinstance(value, Mapping):
        for name, part in value.items():
            yield from iterate_arrays(part, f"{where}.{name}")
    elif hasattr(value, "_fields"):
        for name in value._fields:
            yield from iterate_arrays(getattr(value, name), f"{where}.{name}")
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            yield from iterate_arrays(getattr(value, field.name), f"{where}.{field.name}")
    elif hasattr(value, "data") and hasattr(value, "tocsr"):
        yield where, np.asarray(value.data)
    elif hasattr(value, "dtype") and hasattr(value, "shape"):
        if np.issubdtype(value.dtype, np.inexact):
            yield where, np.asarray(value)
    elif isinstance(value, Sequence | Iterator):
        for number, part in enumerate(value):
            yield from iterate_arrays(part, f"{where}[{number}]")


def _journal(path: Path) -> np.ndarray:
    width = int(str(read_header(path)["width"]))
    with resume_journal(path, HEADER, width):
        return read_records(path)


def _amc(path: Path) -> Any:
    """Read a motion of the synthetic skeleton, or of the captured one, stored with the valid files."""
    skeleton = path.parents[2] / "seeds" / "asf-cmu.asf"
    if "cmu" not in path.name:
        skeleton = path.with_name("own.asf")
        skeleton.write_text(ASF)
    return read_amc(path, read_asf(skeleton))


def _pairs(path: Path) -> list[Any]:
    return [parse_point_pair(path, row) for row in read_pair_table(path)]


def _corrupt_limits(path: Path) -> Any:
    return load_limits(path), read_limits(path, _body().skeleton)


def _mesh(path: Path) -> Any:
    mesh = read_mesh(path)
    return mesh, _clouds(path), read_colours(path, len(mesh.vertices))


def _clouds(path: Path) -> Any:
    scans = read_clouds(path)
    return [scans[frame] for frame in range(min(len(scans), 50))]


def _contents(path: Path) -> Any:
    # bodies are posed when they are shown, which compiles
    return load([str(path)]).notes


@functools.cache
def _body() -> Body:
    """Make the body of limits, parts and motions on demand, as JAX must not be initialised before processes fork."""
    return fuzz_body()


Reader = Callable[[Path], Any]
#: what reads each format; the viewer's loader stands for `info`, which reads by the same functions
READERS: dict[str, tuple[Reader, ...]] = {
    "skl": (read_skeleton,),
    "vj": (lambda path: read_vj(path, _body().skeleton, len(_body().vertices)),),
    "cst": (lambda path: read_cst(path, _body().skeleton),),
    "bvh": (read_motion, read_skeleton),
    "osim": (read_osim,),
    "mot": (read_storage,),
    "tasks": (read_ik_tasks,),
    "mhr": (read_mhr,),
    "skel": (read_skel,),
    "asf": (read_asf, read_skeleton),
    "amc": (_amc,),
    **dict.fromkeys(("off", "obj", "ply", "stl", "glb", "gltf"), (_mesh, _contents)),
    "skinned": (is_skinned, read_skinned, read_gltf, read_mesh),
    **dict.fromkeys(("usda", "usdc", "usdz"), (read_skinned,)),
    **dict.fromkeys(("c3d", "trc", "csv"), (read_marker_file,)),
    "cameras": (read_cameras, _contents),
    "constraints": (lambda path: read_constraints(path, _body()), _contents),
    "vertices": (read_vertex_list,),
    "corrections": (read_corrections,),
    "pairs": (_pairs,),
    "body": (read_body, read_skeleton, load_body_limits),
    "model": (read_body, read_skeleton, read_body_model, read_model_people),
    "motion": (lambda path: read_body_motion(_body(), path), load_skeleton),
    "subject": (load_subject,),
    "limits": (_corrupt_limits, _contents),
    "prior": (lambda path: load_priors(path, _body()), shape_prior_size),
    "shape": (
        lambda path: load_priors(path, _body()),
        lambda path: load_shape_prior(path, _body()),
        read_body,
    ),
    "amass": (read_amass, lambda path: read_body_motion(_body(), path)),
    "checkpoint": (lambda path: load_checkpoint(path, HEADER), load_progress),
    "adapt": (lambda path: restore_state(load_checkpoint(path, HEADER), path),),
    "learn": (lambda path: learn_state_of(load_checkpoint(path, HEADER), path),),
    "journal": (_journal,),
    "meshes": (read_meshes, _contents),
    "clouds": (_clouds, _contents),
    "statistics": (read_statistics,),
    "scans": (lambda path: check_same_scans(path, HEADER),),
}
