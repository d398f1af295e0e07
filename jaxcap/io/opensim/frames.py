"""Frames of OpenSim's models: bodies, and frames that are fixed to them, found by their paths."""

import posixpath
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from ...errors import InputError
from .functions import numbers

GROUND = "ground"
#: elements that add no name to a path
_TRANSPARENT = ("objects", "components", "frames", "Joint")


class Frames:
    """The frames of a model: which body each belongs to, and where it is in that body.

    A path such as `/jointset/hip_r/pelvis_offset` is absolute, or relative to the component that names it. Older files name a
    body by its name alone.
    """

    def __init__(self, root: Element, where: str):
        self._where = where
        self._bodies = {f"/{GROUND}": GROUND}
        self._offsets: dict[str, Element] = {}
        for path, element in _components(root.find("Model"), ""):
            if element.tag == "Body":
                self._bodies[path] = element.get("name", "")
            elif element.tag == "PhysicalOffsetFrame":
                self._offsets[path] = element

    def find(self, name: str, owner: str, label: str) -> tuple[str, Float[np.ndarray, "4 4"]]:
        """Find the body and the offset of a frame that a component with the path `owner` names; `label` is its name in errors.

        **Raises:** `InputError` if there is no such frame, or several have this name.
        """
        path = posixpath.normpath(posixpath.join(owner, name.strip()))
        if path not in self._bodies and path not in self._offsets:
            last = posixpath.basename(path)
            alike = [one for one in (*self._bodies, *self._offsets) if posixpath.basename(one) == last]
            bodies = [one for one in alike if one in self._bodies]
            alike = bodies if len(bodies) == 1 else alike
            if len(alike) != 1:
                raise InputError(
                    f"{self._where}: {label} names the frame '{name.strip()}', of which the model has {len(alike)}; expected a body or "
                    "a frame of the model; open it in OpenSim 4 and save it."
                )
            path = alike[0]
        if path in self._bodies:
            return self._bodies[path], np.eye(4)
        element = self._offsets[path]
        body, under = self.find(element.findtext("socket_parent") or "", path, f"frame '{path}'")
        return body, under @ read_transform(element, "translation", "orientation", f"{self._where}: {path}")


def read_transform(element: Element, place: str, turn: str, where: str) -> Float[np.ndarray, "4 4"]:
    """Read a rigid transform: a translation, and angles about the x, y and z axes of the body."""
    matrix = np.eye(4)
    if element.find(place) is not None:
        matrix[:3, 3] = numbers(element, place, where, 3)
    if element.find(turn) is not None:
        matrix[:3, :3] = Rotation.from_euler("XYZ", numbers(element, turn, where, 3)).as_matrix()
    return matrix


def _components(parent: Element | None, path: str) -> Iterator[tuple[str, Element]]:
    """Iterate over all components with their paths."""
    for element in () if parent is None else parent:
        name = element.get("name")
        if element.tag.endswith("Set"):
            # sets have the path of their kind
            below = f"{path}/{name or element.tag.lower()}"
        elif element.tag in _TRANSPARENT:
            below = path
        elif name is None:
            continue
        else:
            below = f"{path}/{name}"
            yield below, element
        yield from _components(element, below)
