"""Draggable handles in a window: a ball at a target, and a line to the constrained point."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...edit.ik.constraints import Constraint, Position, Quaternion
from ..figures.figure import Colour

if TYPE_CHECKING:
    from viser import SceneApi, SceneNodeDragEvent, TransformControlsEvent
else:
    SceneApi = SceneNodeDragEvent = TransformControlsEvent = Any

Phase = Literal["start", "update", "end"]
#: callback of a drag: the point, the phase, the target position, and the rotation of a joint
DragCallback = Callable[[int | str, Phase, Position | None, Quaternion | None], None]

#: colours of a target that is reached, that is not, and that is pinned
REACHED_COLOUR: Colour = (72, 168, 92)
UNREACHED_COLOUR: Colour = (212, 64, 56)
PINNED_COLOUR: Colour = (58, 110, 200)
LINE_COLOUR: Colour = (60, 60, 60)
#: radius of the dot at a point, relative to its ball
DOT_SCALE = 0.35
#: distance below which a target counts as reached, metres
REACHED_DISTANCE = 0.005


class Handles:
    """The handles of one window's constraints.

    **Arguments:** `scene` of one client; `radius` of the balls, metres; `on_drag` is called during a drag
    in viser's event loop, so it must not block.
    """

    def __init__(self, scene: SceneApi, radius: float, on_drag: DragCallback):
        self.radius = radius
        self._scene, self._told = scene, on_drag
        self._balls: dict[int | str, _Handle] = {}
        self._arrows: _Arrows | None = None
        self._num_made = 0

    def resize(self, radius: float) -> None:
        """Set the radius of all balls, metres."""
        # only for a visible change, as each new size is sent to the browser
        if abs(radius - self.radius) > 0.1 * self.radius:
            self.radius = radius
            for ball in self._balls.values():
                ball.resize(radius)

    def show(
        self,
        constraints: Sequence[Constraint],
        positions: Sequence[Position],
        rotations: Sequence[Quaternion],
        selected: int | str | None,
        arrows: bool,
    ) -> None:
        """Draw a handle for each constraint, with the current positions and rotations of its point; with
        arrows at the selected one."""
        here = {constraint.point for constraint in constraints}
        for point in [point for point in self._balls if point not in here]:
            self._balls.pop(point).remove()
        for constraint, place in zip(constraints, positions, strict=True):
            if constraint.point not in self._balls:
                self._num_made += 1
                self._balls[constraint.point] = _Handle(
                    self._scene, f"/handles/{self._num_made}", constraint, self.radius, self._told
                )
            self._balls[constraint.point].show(constraint, place, constraint.point == selected)
        chosen = next((number for number, one in enumerate(constraints) if one.point == selected), None)
        if self._arrows is not None and (
            chosen is None
            or not arrows
            or self._arrows.point != selected
            or self._balls[self._arrows.point].held
        ):
            self._arrows.remove()
            self._arrows = None
        if chosen is not None and arrows and not self._balls[constraints[chosen].point].held:
            if self._arrows is None:
                self._arrows = _Arrows(self._scene, constraints[chosen].point, 8 * self.radius, self._moved)
            self._arrows.show(constraints[chosen], rotations[chosen])

    def _moved(self, point: int | str, phase: Phase, place: Position | None, turn: Quaternion | None) -> None:
        if place is not None and point in self._balls:
            self._balls[point].put(place)
        self._told(point, phase, place, turn)


class _Handle:
    """A ball, its line, and the dot at the constrained point."""

    def __init__(
        self, scene: SceneApi, name: str, constraint: Constraint, radius: float, on_drag: DragCallback
    ):
        self.point, self.held = constraint.point, False
        self._told, self._offset = on_drag, np.zeros(3)
        self._target = np.array(constraint.target)
        self._line = scene.add_line_segments(
            f"{name}/line",
            np.zeros((1, 2, 3), np.float32),
            LINE_COLOUR,
            thickness=2.0,
            thickness_units="screen",
        )
        self._dot = scene.add_icosphere(
            f"{name}/dot", DOT_SCALE * radius, LINE_COLOUR, subdivisions=1, cast_shadow=False
        )
        self._ball = scene.add_icosphere(
            f"{name}/ball", radius, UNREACHED_COLOUR, subdivisions=2, cast_shadow=False
        )
        # in the plane that faces the camera, under the mouse; async, as only async callbacks keep their order
        self._ball.on_drag("left")(self._dragged)

    def show(self, constraint: Constraint, place: Position, selected: bool) -> None:
        if not self.held:
            self.put(constraint.target)
        distance = float(np.linalg.norm(np.subtract(place, self._target)))
        self._ball.color = (
            PINNED_COLOUR
            if constraint.pinned
            else REACHED_COLOUR
            if distance < REACHED_DISTANCE
            else UNREACHED_COLOUR
        )
        self._ball.opacity = None if selected else 0.6
        self._dot.position = place
        self._line.points = np.array([[place, self._target]], np.float32)

    def resize(self, radius: float) -> None:
        self._ball.radius, self._dot.radius = radius, DOT_SCALE * radius

    def put(self, target: Position) -> None:
        self._target = np.array(target)
        self._ball.position = target

    def remove(self) -> None:
        for node in (self._line, self._dot, self._ball):
            node.remove()

    async def _dragged(self, event: SceneNodeDragEvent) -> None:
        if event.phase == "start":
            # the grabbed point of the ball stays under the mouse
            self.held, self._offset = True, self._target - np.array(event.start_position)
        place = _as_position(np.array(event.end_position) + self._offset)
        if event.phase == "end":
            self.held = False
        else:
            self.put(place)
        self._told(self.point, event.phase, None if event.phase == "end" else place, None)


class _Arrows:
    """Translation arrows at one handle, and rotation rings for a joint."""

    def __init__(self, scene: SceneApi, point: int | str, size: float, on_drag: DragCallback):
        self.point, self.held = point, False
        self._told, self._before = on_drag, np.zeros(4)
        self._node = scene.add_transform_controls(
            "/arrows",
            scale=size,
            line_width=3.0,
            disable_rotations=not isinstance(point, str),
            depth_test=False,
        )
        self._node.on_update(self._updated)

    def show(self, constraint: Constraint, turn: Quaternion) -> None:
        if not self.held:
            self._node.position = constraint.target
            self._node.wxyz = turn if constraint.orientation is None else constraint.orientation

    def remove(self) -> None:
        self._node.remove()

    async def _updated(self, event: TransformControlsEvent) -> None:
        if event.phase == "start":
            self.held, self._before = True, np.array(event.target.wxyz)
        place = _as_position(np.array(event.target.position))
        turn = np.array(event.target.wxyz, float)
        # a joint that was only moved keeps a free rotation
        turned = isinstance(self.point, str) and float(np.abs(turn - self._before).max()) > 1e-4
        if event.phase == "end":
            self.held = False
        w, x, y, z = (float(value) for value in turn)
        self._told(self.point, event.phase, place, (w, x, y, z) if turned else None)


def _as_position(values: np.ndarray) -> Position:
    x, y, z = (float(value) for value in values)
    return x, y, z
