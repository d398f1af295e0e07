"""`jaxcap info`: the contents of a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..io.depth.images import SUFFIXES as IMAGE_SUFFIXES
from ..io.depth.open_exr import EXR_SUFFIX
from ..io.depth.recording import RECORDING_SUFFIXES
from ..io.depth.sequence import shows_organised_points
from ..io.kinds import identify, wrong_kind_error
from ..io.meshes.mesh import SUFFIXES
from ..io.registry import (
    MARKER_READERS,
    MOTION_READERS,
    SKELETON_READERS,
)
from ..io.skinned.clip import split_clip
from .body_models import is_model_spec
from .console.console import say
from .console.options import OptionalUnit, arg
from .contents.arrays import describe_arrays
from .contents.bodies import (
    describe_body,
    describe_bvh,
    describe_mesh,
    describe_model,
    describe_motion_file,
    describe_skinned,
)
from .contents.depth import DepthOptions, describe_camera_depth
from .contents.folders import describe_clouds, describe_folder
from .contents.listing import Contents
from .contents.next_verb import suggest_commands
from .contents.opensim import describe_osim, describe_storage
from .contents.texts import (
    describe_asf,
    describe_journal,
    describe_json,
    describe_kineben,
    describe_markers,
    describe_statistics,
    describe_text,
)
from .depth.sources import Cameras, DepthScale
from .sources import is_human_spec, load_body

#: suffixes of all files that some verb reads
KNOWN = tuple(
    dict.fromkeys(
        (
            *MOTION_READERS,
            *SKELETON_READERS,
            *MARKER_READERS,
            *SUFFIXES,
            ".cst",
            ".vj",
            ".json",
            ".txt",
            EXR_SUFFIX,
            *RECORDING_SUFFIXES,
        )
    )
)


@dataclass
class Info:
    """Describe a file or a folder that some verb reads, and suggest the next command."""

    file: tyro.conf.Positional[Annotated[str, arg(metavar="FILE")]]
    """A file, a folder, a printf pattern or glob of clouds, or `human`."""
    unit: OptionalUnit = None
    """Unit of lengths, if the file states none: m, dm, cm, mm, in or ft."""
    cameras: Cameras = None
    depth_scale: DepthScale = 1000.0

    def run(self) -> None:
        found, options = self.describe(), self.depth_options()
        if found.depth_scale is not None:
            options = options._replace(scale=found.depth_scale)
        say(suggest_commands(found.kind, self.file, found.unit, options))

    def describe(self) -> Contents:
        """Print a description of the contents, and return their kind, and the unit that the next command needs. Raises
        `InputError`."""
        path, unit = Path(self.file), self.unit
        options = self.depth_options()
        if is_model_spec(self.file):
            return Contents(describe_model(self.file))
        if is_human_spec(self.file):
            describe_body(load_body(self.file)[0])
            return Contents("body")
        if shows_organised_points(self.file):
            if self.cameras is not None:
                return describe_camera_depth(self.file, options)
            say(
                "the points are organised in rows of an image; give --cameras to describe it as a depth image"
            )
        if path.is_dir():
            return describe_folder(path, unit, options)
        if not split_clip(path)[0].is_file():
            if path.suffix.lower() in (*IMAGE_SUFFIXES, EXR_SUFFIX):
                return describe_camera_depth(self.file, options)
            return describe_clouds(self.file, unit)
        kind, suffix = identify(path), path.suffix.lower()
        match kind:
            case "bvh":
                return describe_bvh(path, unit)
            case "mesh":
                return describe_mesh(path, unit)
            case "rigged":
                describe_body(load_body(self.file, unit=unit or "m")[0])
                return Contents("rigged", unit)
            case "depth" if suffix != ".npz":
                return describe_camera_depth(self.file, options)
            case "picture" if self.cameras is not None and suffix in IMAGE_SUFFIXES:
                return describe_camera_depth(self.file, options)
            case None:
                raise wrong_kind_error(path, "something that a verb reads", KNOWN)
        known = self.describe_file(path, kind)
        if known is None and suffix == ".json":
            known = describe_json(path)
        return describe_arrays(path, unit, options) if known is None else Contents(known)

    def depth_options(self) -> DepthOptions:
        """Collect the options of depth images."""
        return DepthOptions(self.cameras, self.depth_scale)

    def describe_file(self, path: Path, kind: str) -> str | None:
        """Describe a file of another kind, and return it as the commands name it; None for arrays and JSON files."""
        match kind:
            case "skinned" | "usd":
                return describe_skinned(path)
            case "amc":
                return describe_motion_file(path, self.unit)
            case "asf":
                return describe_asf(path)
            case "skl" | "cst" | "vj":
                return describe_kineben(path, self.unit)
            case "osim":
                return describe_osim(path)
            case "storage":
                return describe_storage(path)
            case "markers":
                return describe_markers(path, self.unit)
            case "statistics" if path.suffix.lower() == ".csv":
                describe_statistics(path)
                return "statistics"
            case "journal":
                return describe_journal(path)
            case "text":
                return describe_text(path)
            case "picture":
                return "picture"
        return None
