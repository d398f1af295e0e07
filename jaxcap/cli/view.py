"""`jaxcap view`: files in a browser window."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from ..body.body import Body
from ..errors import InputError
from ..io.registry import is_rigged
from ..view.app import serve_contents
from ..view.contents import Contents
from ..view.figures.depth_layers import DepthLayers
from ..view.load import load
from ..view.windows.serve import HOST
from .body_models import is_model_spec, load_shaped_body, takes_shape
from .console.console import warn
from .console.options import BODY_FORMATS, DepthSpec, Flag, OptionalUnit, Up, arg
from .console.window import Port, run_window
from .depth.sources import (
    BackgroundChoice,
    Cameras,
    DepthScale,
    Empty,
    Masks,
    choose_frames,
    describe_doubts,
    estimate_backgrounds,
    open_depth_sources,
    read_empty,
)
from .sources import is_human_spec, load_body, up_rotation

Names = tuple[str, ...]


@dataclass
class View:
    """Show files in the browser: bodies, motions, runs, scans, depth images, markers, meshes and cameras.

    Ctrl-C stops the server."""

    files: tyro.conf.Positional[
        Annotated[tuple[str, ...], arg(metavar="FILES...", help_behavior_hint="")]
    ] = ()
    """Files, folders of runs or scans, patterns of clouds, or `human`. Several motions are shown side by side."""
    body: Annotated[
        Names,
        arg(
            metavar="BODY...", help_behavior_hint="", help=f"Bodies to apply to the motions: {BODY_FORMATS}."
        ),
    ] = ()
    clouds: Annotated[Names, arg(metavar="CLOUDS...", help_behavior_hint="")] = ()
    """Clouds to show with the motions: a printf pattern, a quoted glob, a folder or an .npz."""
    depth: DepthSpec = ()
    """Depth images to show with the steps of the search for the person: for each camera a folder, a quoted glob or an
    .npz, as for `jaxcap track`. Needs --cameras."""
    cameras: Cameras = None
    masks: Masks = ()
    empty: Empty = ()
    background: BackgroundChoice = "auto"
    depth_scale: DepthScale = 1000.0
    follow: Flag = False
    """Wait for a run that has not started yet or is resumed, and show its frames as they are solved. A run that is
    still without results is followed even without this option."""
    spacing: Annotated[float | None, arg(metavar="METRES", help_behavior_hint="")] = None
    """Distance between motions, metres; 0 overlays them. Default: chosen from the widths of the motions."""
    rate: Annotated[float | None, arg(metavar="RATE", help_behavior_hint="")] = None
    """Frames per second of an unfinished run. Default: 30."""
    unit: OptionalUnit = None
    """Unit of lengths in files that state none: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of clouds and meshes."""
    port: Port = None
    """Port of the server. Default: 8080 if it is free, else another."""
    host: str = HOST
    """Address of the server. 0.0.0.0 accepts connections from other machines."""
    no_browser: Flag = False
    """Print the address, and do not open a browser."""

    def run(self) -> None:
        if self.rate is not None and not 0 < self.rate < float("inf"):
            raise InputError(f"--rate is {self.rate:g}; it must be above 0 frames per second.")
        if self.cameras is not None and not self.depth:
            raise InputError(
                "--cameras is for depth images; give these with --depth, or cameras alone as FILES."
            )
        if self.spacing is not None and not 0 <= self.spacing < float("inf"):
            raise InputError(f"--spacing is {self.spacing:g}; it must be at least 0 metres.")
        bodies, files = self.bodies()
        contents = load(
            files,
            bodies,
            self.clouds,
            unit=self.unit,
            upright_rotation=up_rotation(self.up),
            rate=self.rate,
            follow=self.follow,
            shape=body_of_motion,
        )
        if self.depth:
            self.add_depths(contents)
        if contents.is_empty:
            raise InputError(
                " ".join(contents.notes)
                or "There is nothing to show; give a body, a motion, clouds, markers, meshes or cameras."
            )
        for note in contents.notes:
            warn(note)
        run_window(
            "view",
            ", ".join(Path(name).name for name in (*self.files, *self.depth)),
            lambda server: serve_contents(server, contents, self.spacing),
            self.port,
            self.host,
            not self.no_browser,
        )

    def add_depths(self, contents: Contents) -> None:
        """Add depth images with the steps of the search for the person. Raises `InputError`."""
        sources = open_depth_sources(self.depth, self.cameras, self.masks, self.depth_scale, up=self.up)
        if self.empty:
            backgrounds = read_empty(sources.cameras, sources.recorded, self.empty, self.depth_scale)
        else:
            numbers = choose_frames(sources) if self.background == "auto" else []
            backgrounds = estimate_backgrounds(sources, numbers)
        contents.notes.extend(f"{doubt[0].upper()}{doubt[1:]}." for doubt in describe_doubts(backgrounds))
        images = sources.images

        def load(number: int):
            frame = images[number]
            return frame.depths, frame.masks

        contents.depths.append(DepthLayers(sources.cameras, len(images), load, backgrounds))
        contents.cameras.extend(sources.cameras)

    def bodies(self) -> tuple[list[tuple[str, Body]], list[str]]:
        """Load the bodies given by name or as a mesh with its skeleton files, and list the remaining
        files."""
        named = [name for name in self.files if is_human_spec(name) or is_model_spec(name) or is_rigged(name)]
        return (
            [(name, load_body(name, unit=self.unit or "m", up=self.up)[0]) for name in (*self.body, *named)],
            [name for name in self.files if name not in named],
        )


def body_of_motion(spec: str, motion: Path) -> Body | None:
    """Load a body model in the shape of a motion in AMASS's format; None for other bodies and motions. Raises `InputError`."""
    return load_shaped_body(spec, motion) if takes_shape(spec, motion) else None
