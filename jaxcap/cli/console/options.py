"""Types of options that several verbs share, with their metavariables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import tyro

from ...errors import InputError
from ..sources import BODY_FORMATS as BODY_FORMATS
from ..sources import Up as Up

arg = tyro.conf.arg
#: descriptions of motion and skeleton files for every help text; see `motions`
MOTION_FORMATS = (
    ".bvh, .npz, .amc (with its .asf in the same folder), or a skinned .glb, .gltf or USD with an animation "
    "(`character.glb:Walk` selects one of several clips)"
)
SKELETON_FORMATS = (
    ".skl, .bvh, .asf, a body or motion .npz, a skinned .glb, .gltf or USD, or `human` with options"
)
#: bodies, motions and clouds as command line arguments; see `sources`
BodySpec = tyro.conf.Positional[Annotated[str, arg(metavar="BODY", help=f"A body: {BODY_FORMATS}.")]]
MotionSpec = tyro.conf.Positional[Annotated[Path, arg(metavar="MOTION", help=f"A motion: {MOTION_FORMATS}.")]]
MotionsSpec = tyro.conf.Positional[
    Annotated[tuple[str, ...], arg(metavar="MOTIONS...", help_behavior_hint="")]
]
CloudsSpec = tyro.conf.Positional[
    Annotated[
        tuple[str, ...],
        arg(
            metavar="CLOUDS...",
            help_behavior_hint="",
            help="Point clouds: a file per frame (`scans/*.ply`), a printf pattern (`scan_%04d.ply`), a folder, or an .npz "
            "with the array `points` (F, N, 3), for F frames of N points.",
        ),
    ]
]
DepthSpec = Annotated[tuple[str, ...], arg(metavar="IMAGES...", help_behavior_hint="")]
OptionalBody = Annotated[
    str | None,
    arg(metavar="BODY", help_behavior_hint="", help=f"Body of the motion: {BODY_FORMATS}."),
]
OptionalFile = Annotated[Path | None, arg(metavar="FILE", help_behavior_hint="")]
Skl = Annotated[
    OptionalFile,
    arg(
        help="Skeleton of BODY if it is a mesh. Default: the .skl with the name of the mesh, in the same folder."
    ),
]
Vj = Annotated[
    OptionalFile,
    arg(
        help="Joint of each vertex of BODY if it is a mesh. Default: the .vj with the name of the mesh, in the same folder."
    ),
]
OptionalCount = Annotated[int | None, arg(metavar="N", help_behavior_hint="")]
OptionalUnit = Annotated[str | None, arg(metavar="UNIT", help_behavior_hint="")]
Unit = Annotated[str, arg(metavar="UNIT")]
Workers = Annotated[
    OptionalCount,
    arg(
        help="Track one long sequence in chunks, on N worker processes of this computer (Dask). See also `jaxcap batch`."
    ),
]
Scheduler = Annotated[
    str | None,
    arg(
        metavar="ADDRESS",
        help_behavior_hint="",
        help="Track in chunks on the workers of a running Dask scheduler, such as tcp://10.0.0.1:8786, which see the same files.",
    ),
]
NumChunks = Annotated[
    OptionalCount,
    arg(help="Number of chunks. Default: chunks of about 200 to 500 frames."),
]
Flag = Annotated[bool, arg(help_behavior_hint="")]
KeepPlanes = Annotated[
    bool,
    arg(
        help_behavior_hint="",
        help="Keep the points of floors and walls. By default those that the first cloud shows are removed from all "
        "clouds.",
    ),
]


def clouds_words(clouds: Sequence[str]) -> str:
    """Abbreviate the list of cloud files, as a shell expands one glob to many."""
    if len(clouds) <= 1:
        return "".join(clouds)
    return f"{clouds[0]} ... {clouds[-1]} ({len(clouds)} files)"


def check_ranges(options: Mapping[str, tuple[int | float | None, bool, str]]) -> None:
    """Check options, each by its value, whether the value is in range, and the range in words. Raises `InputError`."""
    for name, (value, is_in_range, words) in options.items():
        if not is_in_range:
            raise InputError(f"{name} is {value:g}; it must be {words}.")
