"""Inverse kinematics in a window: click a point of the body and drag it, and the body follows (Kineben,
section 4.2.1). Each browser has its own session and its own solver thread. The solver always takes the newest
target; targets that arrive while it runs are skipped."""

import threading
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ...body.body import Body, pose_body
from ...body.pose import Pose
from ...edit.ik import session as ik
from ...edit.ik.constraints import Position, Quaternion
from ...edit.ik.point_positions import bone_rotations, point_positions
from ...edit.ik.session import IkSession
from ...errors import user_message
from ..figures.eye import BEGIN, FIELD, place_camera
from ..figures.figure import BodyFigure
from ..figures.pick import pick_point, pick_sphere
from ..figures.scenery import add_floor
from ..figures.skeleton_figure import SkeletonFigure
from ..windows.serve import serve_clients
from .controls import IkControls
from .files import constraints_file, load_session_file, pose_file
from .handles import Handles, Phase
from .inbox import Inbox

if TYPE_CHECKING:
    from viser import ClientHandle, SceneClickEvent, ViserServer
else:
    ClientHandle = SceneClickEvent = ViserServer = Any

#: seconds within which a closed browser is noticed
CLOSE_TIMEOUT = 0.25
#: radius of a handle's ball on the screen, pixels: a diameter of 24 is easy to hit
BALL_PIXELS = 12.0
#: its minimum and maximum, relative to the body's size
BALL_SIZE_RANGE = (0.004, 0.04)
#: the answer to a click that hits nothing
NO_HIT = "There is nothing where you clicked: click the body to constrain a point, or drag a ball."


class ShownGeometry(NamedTuple):
    """The geometry of a session that a window has drawn, metres."""

    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "J 3"]


def serve_ik(server: ViserServer, session: IkSession) -> list["IkWindow"]:
    """Open a window for every browser that connects, with a session that begins as `session`. The returned
    list holds the open windows."""
    windows: list[IkWindow] = []

    def visit(client: ClientHandle, gone: threading.Event) -> None:
        window = IkWindow(client, session)
        windows.append(window)
        try:
            window.run(gone)
        finally:
            windows.remove(window)

    serve_clients(server, visit)
    return windows


class IkWindow:
    """The window of one browser; only the thread of `run` changes its `session`."""

    def __init__(self, client: ClientHandle, session: IkSession):
        self.client, self.session = client, session
        self.selected: int | str | None = None
        #: the error of the last request, in a sentence
        self.note = "Preparing the solver."
        self._inbox, body = Inbox(), session.body
        with client.atomic():
            self._surface = BodyFigure(client.scene, "/body", body)
            self._skeleton = SkeletonFigure(client.scene, "/skeleton", body.skeleton)
            self._skeleton.visible = False
            self._home = np.concatenate([np.asarray(body.vertices), np.asarray(body.skeleton.centres)])
            low, high = self._home.min(0), self._home.max(0)
            self.size, self.middle = float((high - low).max()), (low + high) / 2
            self.handles = Handles(client.scene, BALL_SIZE_RANGE[0] * self.size, self._dragged)
            self.controls = IkControls(
                client,
                session,
                self._inbox.put,
                self._constrain,
                self._redraw,
                self._save,
                self._load,
                self.camera,
            )
            floor = add_floor(client.scene, 6 * self.size, 0.1 * self.size)
            floor.position = (float(self.middle[0]), float(low[1]), float(self.middle[2]))
            self.camera(BEGIN)
        self.shown = self._show()
        client.scene.on_click()(self._clicked)

    def run(self, gone: threading.Event) -> None:
        """Apply requests and show the result, until the browser closes."""
        self._resize()
        # the first solve compiles, before a user waits for it; it changes nothing
        preparing = self.note
        self._apply_edit(ik.solve_session)
        self.note = "" if self.note == preparing else self.note
        self.shown = self._show()
        while not gone.is_set():
            verbs = self._inbox.take(0.0 if self._unfinished() else CLOSE_TIMEOUT)
            if verbs:
                self.note = ""
            for verb in verbs or ([ik.solve_session] if self._unfinished() else []):
                self.session = self._apply_edit(verb)
                verbs = verbs or [verb]
            if not gone.is_set():
                self._resize()
                if verbs:
                    self.shown = self._show()

    def camera(self, name: str) -> None:
        """Set the camera to view the body, from a direction of `eye.DIRECTIONS`."""
        camera = self.client.camera
        camera.fov = float(FIELD)
        positions = self.shown.vertices if name != BEGIN else self._home
        box = np.stack([positions.min(0), positions.max(0)]).astype(float)
        size = float(camera.image_width), float(camera.image_height)
        eye, target = place_camera(box, name, *size, camera.fov)
        with self.client.atomic():
            # in this order, as the target moves with the camera
            camera.position = eye
            camera.look_at = target

    def _resize(self) -> None:
        """Keep the balls at one size on the screen at any camera distance."""
        camera = self.client.camera
        away = float(np.linalg.norm(np.subtract(camera.position, camera.look_at)))
        pixel = 2 * away * np.tan(camera.fov / 2) / max(camera.image_height, 1)
        least, most = (share * self.size for share in BALL_SIZE_RANGE)
        self.handles.resize(min(max(BALL_PIXELS * float(pixel), least), most))

    def _apply_edit(self, edit: ik.Edit) -> IkSession:
        try:
            return edit(self.session)
        except ValueError as error:
            self.note = user_message(error)
        except Exception as error:
            # a solver or a user's energy may raise anything: the session before it is intact
            self.note = f"The edit failed ({type(error).__name__}: {error}); the pose is unchanged."
        return self.session

    def _unfinished(self) -> bool:
        """Check if a drag goes on and its last solve ran out of steps."""
        solution = self.session.solution
        if self.session.drag_start is None or solution is None:
            return False
        return bool(solution.result == optx.RESULTS.nonlinear_max_steps_reached)

    def _show(self) -> ShownGeometry:
        session, state = self.session, self.session.state
        vertices, joints, rotations = (np.asarray(found) for found in posed_arrays(session.body, state.pose))
        positions = point_positions(session.body, state.pose, state.constraints)
        whole = bone_rotations(session.body, state.pose)
        names = session.body.skeleton.names
        turns = [
            whole[names.index(one.point)] if isinstance(one.point, str) else whole[0]
            for one in state.constraints
        ]
        if all(one.point != self.selected for one in state.constraints):
            self.selected = None
        with self.client.atomic():
            self._surface.show(vertices)
            self._skeleton.show(joints, rotations)
            self._skeleton.visible = self.controls.skeleton
            self._surface.translucent = self.controls.skeleton
            self.handles.show(state.constraints, positions, turns, self.selected, self.controls.arrows)
            self.controls.draw(session, self.selected, self.note)
        return ShownGeometry(vertices, joints)

    def _clicked(self, event: SceneClickEvent) -> None:
        """Select the clicked handle, or constrain the clicked point of the body."""
        shown, session = self.shown, self.session
        eye, ray = np.array(event.ray_origin), np.array(event.ray_direction)
        constraints = session.state.constraints
        targets = np.array([one.target for one in constraints]).reshape(-1, 3)
        handle = pick_sphere(targets, eye, ray, self.handles.radius)
        if handle is not None:
            self._select(constraints[handle].point)
            return
        joints = shown.joints if self.controls.skeleton else None
        point = pick_point(
            eye, ray, shown.vertices, np.asarray(session.body.faces), joints, session.body.skeleton.names
        )
        if point is not None:
            self._constrain(point)
        else:
            self._inbox.put(_raise_no_hit)

    def _constrain(self, point: int | str) -> None:
        def constrain(session: IkSession) -> IkSession:
            self.selected = point
            return ik.add_constraint(session, point)

        self._inbox.put(constrain)

    def _dragged(
        self, point: int | str, phase: Phase, place: Position | None, turn: Quaternion | None
    ) -> None:
        if phase == "start":
            self.selected = point
            self._inbox.put(ik.begin_drag)
        if place is not None or turn is not None:
            self._inbox.put(lambda session: ik.drag(session, point, place, turn), ("drag", point))
        if phase == "end":
            self._inbox.put(ik.end_drag)

    def _select(self, point: int | str) -> None:
        def chosen(session: IkSession) -> IkSession:
            self.selected = point
            return session

        self._inbox.put(chosen)

    def _redraw(self) -> None:
        self._inbox.put(lambda session: session)

    def _save(self, suffix: str) -> None:
        def saved(session: IkSession) -> IkSession:
            if suffix == ".json":
                name, content = "constraints.json", constraints_file(session)
            else:
                name, content = f"pose{suffix}", pose_file(session, suffix)
            self.client.send_file_download(name, content, save_immediately=True)
            return session

        self._inbox.put(saved)

    def _load(self, name: str, content: bytes) -> None:
        self._inbox.put(lambda session: load_session_file(session, name, content))


def _raise_no_hit(session: IkSession) -> IkSession:
    raise ValueError(NO_HIT)


@eqx.filter_jit
def posed_arrays(
    body: Body, pose: Pose
) -> tuple[Float[Array, "V 3"], Float[Array, "J 3"], Float[Array, "J 3 3"]]:
    """Compute the vertices, joints and bone rotations of a posed body, in single precision for a window."""
    posed = pose_body(body, pose)
    found = posed.vertices, posed.joints, posed.transforms.rotations
    return jax.tree.map(lambda values: values.astype(jnp.float32), found)
