"""One take in a window, with the scans it is compared with."""

from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from ...errors import InputError, user_message
from ..contents import Take
from ..figures.clouds import DisplayCloud, DisplayClouds
from ..figures.depth_layers import LAYER_COLOURS, MEASURED
from ..figures.figure import CLAY, BodyFigure, Colour
from ..figures.pick import pick_point
from ..figures.points import LabelledPoints, PointFigure
from ..figures.posing import PosedFrame, PosedMotion
from ..figures.scan_colours import (
    DEFAULT_SIGMA,
    PartColours,
    ScanHeat,
    heat_classes,
    heat_palette,
    make_part_colours,
    posterior_colours,
    scan_heat,
)
from ..figures.skeleton_figure import BONE, SkeletonFigure, sample_bones

if TYPE_CHECKING:
    from viser import SceneApi
else:
    SceneApi = Any

PLAIN, DISTANCE, POSTERIOR = "plain", "distance to the scan", "posterior of the parts"
#: colours of the takes side by side
TAKE_COLOURS: tuple[Colour, ...] = (CLAY, (121, 178, 160), (201, 151, 166), (158, 154, 205), (200, 183, 120))
#: colours of the bones of takes without a surface
BONE_COLOURS: tuple[Colour, ...] = (BONE, (52, 120, 190), (62, 150, 92), (190, 74, 96), (126, 88, 178))
#: layers of depth images that are shown at first: all but the one that contains the others
SHOWN_LAYERS = tuple(name for name in LAYER_COLOURS if name != MEASURED)
#: number of frames in the cache of distances; each is some 80 kB
MAX_CACHED_HEATS = 1_000


@dataclass(frozen=True)
class Choice:
    """The display choices of one browser."""

    surface: bool = True
    skeleton: bool = False
    frames: bool = False
    names: bool = False
    scan: bool = True
    markers: bool = True
    colours: str = PLAIN
    #: upper end of the scale of distances, metres
    limit: float = 0.02
    #: the layers of depth images, by name
    layers: tuple[str, ...] = SHOWN_LAYERS


class Appearance(NamedTuple):
    """The computed appearance of a column at one time."""

    posed: PosedFrame | None
    #: colours of the vertices
    classes: Int[np.ndarray, "V"] | None
    palette: UInt8[np.ndarray, "K 3"] | None
    #: points and colours of the scan
    points: Float[np.ndarray, "N 3"] | None
    colours: UInt8[np.ndarray, "N 3"] | None
    #: the error of the scan, in a sentence
    error: str


class Column:
    """One take, or scans alone, in one browser."""

    def __init__(
        self, scene: SceneApi, name: str, number: int, take: Take | None, clouds: DisplayClouds | None
    ):
        self.take, self.clouds, self.name = take, clouds, name
        self.group = scene.add_frame(name, show_axes=False)
        self.body: BodyFigure | None = None
        self.skeleton: SkeletonFigure | None = None
        self.markers: LabelledPoints | None = None
        colour = TAKE_COLOURS[number % len(TAKE_COLOURS)]
        if take is not None:
            if take.motion.body is not None:
                self.body = BodyFigure(scene, f"{name}/body", take.motion.body, colour)
            bones = BONE if self.body is not None else BONE_COLOURS[number % len(BONE_COLOURS)]
            self.skeleton = SkeletonFigure(scene, f"{name}/skeleton", take.motion.skeleton, bones)
            self.skeleton.visible = False
            if take.subject is not None:
                self.markers = LabelledPoints(scene, f"{name}/markers", take.subject.labels)
        self.scan = None if clouds is None else PointFigure(scene, f"{name}/scan")
        #: the last drawn appearance
        self.drawn: Appearance | None = None
        self._heats: OrderedDict[int, ScanHeat] = OrderedDict()
        self._parts: PartColours | None = None
        self._scan_numbers = {} if clouds is None else _match_scans(take, clouds)

    def appearance(self, time: float, frame: int, choice: Choice) -> Appearance:
        """Compute everything to draw at a time of the takes, seconds, which is `frame` of the scans."""
        posed, body = None, None
        if self.take is not None:
            frame = min(round(time * self.take.rate), len(self.take.motion) - 1)
            posed, body = self.take.motion.frame(frame), self.take.motion.body
        asked = self.clouds is not None and (choice.scan or choice.colours == DISTANCE)
        cloud, wrong = self._cloud(frame) if asked else (None, "")
        points, colours, classes, palette = None if cloud is None else cloud.points, None, None, None
        if body is not None and posed is not None and choice.colours == DISTANCE and cloud is not None:
            heat, palette = self._heat(frame, cloud, posed, np.asarray(body.faces)), heat_palette()
            classes = heat_classes(heat.vertices, choice.limit)
            points, colours = heat.points, palette[heat_classes(heat.distances, choice.limit)]
        elif body is not None and posed is not None and choice.colours == POSTERIOR:
            parts = self._parts = self._parts or make_part_colours(body)
            classes, palette = parts.vertices, parts.palette
            if cloud is not None:
                points, colours = posterior_colours(parts, posed.vertices, cloud, self._sigma(frame))
        return Appearance(posed, classes, palette, points, colours, wrong)

    def draw(self, look: Appearance, choice: Choice) -> None:
        """Send a computed appearance."""
        self.drawn = look
        if look.posed is not None:
            if self.body is not None:
                self.body.visible = choice.surface
                self.body.colours(look.classes, look.palette)
                self.body.show(look.posed.vertices)
            self._draw_bones(look.posed, choice)
        if self.scan is not None:
            if choice.scan and look.points is not None:
                self.scan.show(look.points, look.colours)
            else:
                self.scan.hide()

    def extent(self, current: bool = False) -> Float[np.ndarray, "2 3"]:
        """Return the bounding box of the first frame, or of the current one (`current`), without the column's
        offset, metres."""
        points = np.zeros((0, 3))
        if self.take is not None:
            shown = self.drawn.posed if current and self.drawn is not None else None
            posed = shown or self.take.motion.frame(0)
            points = np.concatenate([posed.vertices, posed.joints])
        if self.clouds is not None and len(points) == 0:
            cloud, _ = self._cloud(0)
            points = points if cloud is None else cloud.points
        return np.stack([points.min(0), points.max(0)]) if len(points) else np.array([[-1.0] * 3, [1.0] * 3])

    def pick(
        self, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"], choice: Choice
    ) -> tuple[str, Float[np.ndarray, "3"]] | None:
        """Pick the drawn object that a ray hits: its description and position, both in the column's own
        world."""
        look = self.drawn
        if look is None:
            return None
        if look.posed is not None and self.take is not None:
            picked = self._pick_take(self.take.motion, look.posed, origin, direction, choice)
            if picked is not None:
                return f"{self.take.name}: {picked[0]}", picked[1]
        if choice.scan and look.points is not None and len(look.points):
            nothing = np.zeros((0, 3), int)
            point = pick_point(origin, direction, look.points, nothing)
            if isinstance(point, int):
                return "a point of the scan", look.points[point]
        return None

    def _pick_take(
        self,
        motion: PosedMotion,
        posed: PosedFrame,
        origin: np.ndarray,
        direction: np.ndarray,
        choice: Choice,
    ) -> tuple[str, Float[np.ndarray, "3"]] | None:
        joints, names = None, ()
        if self.skeleton is not None and self.skeleton.visible:
            joints, names = sample_bones(motion.skeleton, posed.joints)
        body = motion.body if choice.surface else None
        vertices = posed.vertices if body is not None else posed.vertices[:0]
        faces = np.zeros((0, 3), int) if body is None else np.asarray(body.faces)
        point = pick_point(origin, direction, vertices, faces, joints, names)
        if isinstance(point, str):
            return f"bone {point}", posed.joints[motion.skeleton.index(point)]
        if point is None or body is None:
            return None
        part = motion.skeleton.names[int(body.skin.dominant_bones()[point])]
        return f"vertex {point}, part {part}", posed.vertices[point]

    def _cloud(self, frame: int) -> tuple[DisplayCloud | None, str]:
        """Return the scan of a frame of the take, if there is one, or the reason why there is none."""
        number = self._scan_numbers.get(frame, -1) if self._scan_numbers else frame
        if self.clouds is None or not 0 <= number < len(self.clouds):
            return None, ""
        try:
            return self.clouds[number], ""
        except InputError as error:
            return None, user_message(error)

    def _draw_bones(self, posed: PosedFrame, choice: Choice) -> None:
        assert self.take is not None and self.skeleton is not None
        # without a surface the bones are always shown
        self.skeleton.visible = self.body is None or choice.skeleton or choice.frames or choice.names
        if self.body is not None:
            self.body.translucent = self.skeleton.visible
        if self.skeleton.visible:
            if self.skeleton.frames != choice.frames:
                self.skeleton.frames = choice.frames
            if self.skeleton.names != choice.names:
                self.skeleton.names = choice.names
            self.skeleton.show(posed.joints, posed.rotations)
        if self.markers is not None and self.take.subject is not None:
            subject, centres = self.take.subject, np.asarray(self.take.motion.skeleton.centres)
            bones = np.asarray(subject.bones)
            offsets = np.asarray(subject.offsets) - centres[bones]
            positions = np.einsum("mab,mb->ma", posed.rotations[bones], offsets) + posed.joints[bones]
            if choice.markers:
                self.markers.show(positions, np.asarray(subject.weights) > 0, choice.names)
            else:
                self.markers.hide()

    def _heat(self, frame: int, cloud: DisplayCloud, posed: PosedFrame, faces: np.ndarray) -> ScanHeat:
        running = self.take is not None and self.take.run_folder is not None
        if frame not in self._heats or running:
            heat = scan_heat(cloud, posed.vertices, faces)
            self._heats[frame] = ScanHeat(*(values.astype(np.float32) for values in heat))
            while len(self._heats) > MAX_CACHED_HEATS:
                self._heats.popitem(last=False)
        return self._heats[frame]

    def _sigma(self, frame: int) -> float:
        sigmas = () if self.take is None else self.take.sigmas
        return sigmas[frame] if frame < len(sigmas) else DEFAULT_SIGMA


def _match_scans(take: Take | None, clouds: DisplayClouds) -> dict[int, int]:
    """Match each frame of a take to its scan by the names in its statistics; empty if they are of other
    scans."""
    numbers = {
        name.replace("\\", "/").rsplit("/", 1)[-1]: number for number, name in enumerate(clouds.scans.names)
    }
    names = () if take is None else take.clouds
    return {frame: numbers[name] for frame, name in enumerate(names) if name in numbers}
