"""The steps from a depth image to the person, as layers of points: computed on first use, and cached."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ...depth.back_projection import world_points
from ...depth.background import Background
from ...depth.candidates import PERSON, PIECE, Candidate, join_candidates
from ...depth.person import search_person
from ...errors import InputError, user_message
from ...geometry.camera import Camera
from ...observe.floor import find_floor
from .clouds import sample_rows

MEASURED, PLANES, BACKGROUND = "measured points", "floors and walls", "background"
CANDIDATES, PERSON_LAYER = "candidates", "person"
#: colours of the layers, in the order of the steps
LAYER_COLOURS = {
    MEASURED: (150, 150, 150),
    PLANES: (104, 142, 178),
    BACKGROUND: (133, 158, 122),
    CANDIDATES: (214, 140, 52),
    PERSON_LAYER: (200, 44, 70),
}
#: largest number of drawn points of a layer, of frames in the cache, and of labels of a layer
MAX_LAYER_POINTS, MAX_CACHED_FRAMES, MAX_LABELS = 40_000, 30, 20
#: least area of a candidate with a label, square metres; height of labels above their surface, metres
MIN_LABELLED_AREA, LABEL_HEIGHT = 0.01, 0.08

#: loads the depths and the masks of all cameras in a frame
Load = Callable[[int], tuple[Sequence[np.ndarray], Sequence[np.ndarray | None]]]


class Layer(NamedTuple):
    """Points of one step, metres, and labels with their positions."""

    points: Float[np.ndarray, "N 3"]
    labels: list[tuple[str, Float[np.ndarray, "3"]]]


class FrameLayers(NamedTuple):
    """The layers of a frame by name, and what is wrong with it, in sentences."""

    layers: dict[str, Layer]
    note: str = ""


class DepthLayers:
    """The layers of a sequence of depth images, shared by several windows.

    **Arguments:** `cameras`, y up; `count`, the number of frames; `load`; `backgrounds`, one for each camera.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        count: int,
        load: Load,
        backgrounds: Sequence[Background | None],
    ):
        self.cameras, self._count, self._load, self.backgrounds = cameras, count, load, backgrounds
        self._kept: OrderedDict[int, FrameLayers] = OrderedDict()
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, frame: int) -> FrameLayers:
        """Return the layers of a frame; one that cannot be read has none, and a note."""
        with self._lock:
            if frame not in self._kept:
                self._kept[frame] = self._compute(frame)
            self._kept.move_to_end(frame)
            while len(self._kept) > MAX_CACHED_FRAMES:
                self._kept.popitem(last=False)
            return self._kept[frame]

    def _compute(self, frame: int) -> FrameLayers:
        found: dict[str, list[Layer]] = {name: [] for name in LAYER_COLOURS}
        notes = []
        try:
            depths, masks = self._load(frame)
            for number, (camera, depth, mask) in enumerate(zip(self.cameras, depths, masks, strict=True)):
                where = f"Camera {number}" if len(self.cameras) > 1 else "This frame"
                layers, note = explain_depth(camera, depth, self.backgrounds[number], mask, where)
                notes += [note] if note else []
                for name, layer in layers.items():
                    found[name].append(layer)
        except InputError as error:
            notes.append(user_message(error))
        return FrameLayers({name: _join(layers) for name, layers in found.items()}, " ".join(notes))


def explain_depth(
    camera: Camera,
    depth: Float[np.ndarray, "H W"],
    background: Background | None = None,
    mask: Bool[np.ndarray, "H W"] | None = None,
    where: str = "This frame",
) -> tuple[dict[str, Layer], str]:
    """Divide the points of a depth image into the layers of the search for a person, or of a `mask`.

    Return also what is wrong, in a sentence. **Raises:** `InputError` as `search_person` does.
    """
    steps = search_person(camera, depth, background, where)
    points = world_points(camera, depth)
    measured = depth > 0
    floor = find_floor(steps.planes)
    planes = []
    for plane in steps.planes:
        near = points[steps.on_planes][np.abs(points[steps.on_planes] @ plane.normal - plane.offset) < 0.03]
        if len(near):
            planes.append(("floor" if plane is floor else "plane", np.median(near, axis=0)))
    person = steps.person if mask is None else mask & measured
    found = [one for one in steps.candidates if mask is None and one.found in (PERSON, PIECE)]
    found.sort(key=lambda one: one.found != PERSON)
    others = [one for one in steps.candidates if mask is not None or one.found not in (PERSON, PIECE)]
    surface = np.zeros(depth.shape, bool)
    surface[:: steps.step, :: steps.step] = np.isin(steps.labels, [one.label for one in others])
    large = sorted((one for one in others if one.area >= MIN_LABELLED_AREA), key=lambda one: -one.area)
    chosen = [_label(join_candidates(found))] if found else []
    if mask is not None:
        # what would be found without the mask is not named
        large = []
        chosen = [("the person, by the mask", _top(points[person]))] if person.any() else []
    layers = {
        MEASURED: Layer(points[measured], []),
        PLANES: Layer(points[steps.on_planes & ~person], planes),
        BACKGROUND: Layer(points[steps.on_background & ~person], []),
        CANDIDATES: Layer(points[surface & ~person], [_label(one) for one in large[:MAX_LABELS]]),
        PERSON_LAYER: Layer(points[person], chosen),
    }
    nobody = f"{where} shows no person: {'the mask is empty' if mask is not None else 'no surface has the size of one'}."
    return layers, "" if person.any() else nobody


def _label(one: Candidate) -> tuple[str, np.ndarray]:
    size = f"{one.extent:.2f} m, {one.area:.2f} m², {one.distance:.1f} m away"
    return f"{one.found}: {size}", _top(one.points)


def _top(points: np.ndarray) -> np.ndarray:
    middle = np.median(points, axis=0)
    middle[1] = points[:, 1].max() + LABEL_HEIGHT
    return middle


def _join(layers: list[Layer]) -> Layer:
    points = np.concatenate([layer.points for layer in layers]) if layers else np.zeros((0, 3))
    kept = points[sample_rows(len(points), MAX_LAYER_POINTS)]
    return Layer(kept, [label for layer in layers for label in layer.labels])
