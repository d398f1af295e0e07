"""`jaxcap info`: the contents of a file."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..io.kinds import identify, wrong_kind
from ..io.meshes.mesh import SUFFIXES
from ..io.registry import (
    MARKER_READERS,
    MOTION_READERS,
    SKELETON_READERS,
)
from ..io.skinned.clip import split_clip
from .console.console import say
from .console.options import OptionalUnit, arg
from .contents.arrays import tell_arrays
from .contents.bodies import tell_body, tell_bvh, tell_mesh, tell_moving, tell_skinned
from .contents.folders import tell_clouds, tell_folder
from .contents.next_verb import next_verbs
from .contents.texts import (
    tell_asf,
    tell_journal,
    tell_json,
    tell_kineben,
    tell_markers,
    tell_statistics,
    tell_text,
)
from .sources import load_body, names_human

#: suffixes of all files that some verb reads
KNOWN = tuple(
    dict.fromkeys(
        (*MOTION_READERS, *SKELETON_READERS, *MARKER_READERS, *SUFFIXES, ".cst", ".vj", ".json", ".txt")
    )
)


@dataclass
class Info:
    """Describe a file or a folder that any verb reads, and suggest the next command."""

    file: tyro.conf.Positional[Annotated[str, arg(metavar="FILE")]]
    """A file, a folder, a printf pattern or glob of clouds, or `human`."""
    unit: OptionalUnit = None
    """Unit of lengths, if the file states none: m, dm, cm, mm, in or ft."""

    def run(self) -> None:
        path = Path(self.file)
        if identify(path) == "bvh":
            kind, unit = tell_bvh(path, self.unit)
            say(next_verbs(kind, self.file, unit))
        else:
            say(next_verbs(self.tell(), self.file))

    def tell(self) -> str:
        """Print a description of the contents, and return their kind. Raises `InputError`."""
        path, unit = Path(self.file), self.unit or "m"
        if names_human(self.file):
            tell_body(load_body(self.file)[0])
            return "body"
        if path.is_dir():
            return tell_folder(path, unit)
        if not split_clip(path)[0].is_file():
            return tell_clouds(self.file, unit)
        kind = identify(path)
        match kind:
            case "skinned" | "usd":
                return tell_skinned(path)
            case "rigged":
                tell_body(load_body(self.file, unit=unit)[0])
                return "rigged"
            case "mesh":
                return tell_mesh(path, unit)
            case "amc":
                return tell_moving(path, self.unit)
            case "asf":
                return tell_asf(path)
            case "skl" | "cst" | "vj":
                return tell_kineben(path, self.unit)
            case "markers":
                return tell_markers(path, self.unit)
            case "statistics" if path.suffix.lower() == ".csv":
                tell_statistics(path)
                return "statistics"
            case "journal":
                return tell_journal(path)
            case "text":
                return tell_text(path)
            case "picture":
                return "picture"
            case None:
                raise wrong_kind(path, "something that a verb reads", KNOWN)
        return tell_json(path) if path.suffix.lower() == ".json" else tell_arrays(path, unit)
