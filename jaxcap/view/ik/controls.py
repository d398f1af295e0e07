"""The controls of inverse kinematics in one window. They request edits and show the state of a session."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...edit.ik import session as ik
from ...edit.ik.constraints import Constraint, describe
from ...edit.ik.session import IkSession, IkSettings
from ...edit.ik.solve import Solver
from ..figures.eye import FRONT, SIDE, TOP
from ..windows.text import as_markdown

if TYPE_CHECKING:
    from viser import ClientHandle
    from viser._messages import HotkeyKey
else:
    ClientHandle = HotkeyKey = Any

#: labels of the solvers
SOLVERS: dict[str, Solver] = {
    "Levenberg-Marquardt": "levenberg-marquardt",
    "Gauss-Newton": "gauss-newton",
    "Priorities": "priorities",
}
HELP = "Click the body to constrain a point, and drag its ball to move it."
NOTHING = "no constraint is selected"


class IkControls:
    """**Arguments:** `client`; the `session` that sets the initial values; `ask` receives an edit; `hold` a
    point to constrain; `redraw` is called if only the display changes; `save` takes a suffix, `load` a file's
    name and content; `see` the name of a direction to look from."""

    def __init__(
        self,
        client: ClientHandle,
        session: IkSession,
        ask: Callable[[ik.Verb], None],
        hold: Callable[[int | str], None],
        redraw: Callable[[], None],
        save: Callable[[str], None],
        load: Callable[[str, bytes], None],
        see: Callable[[str], None],
    ):
        gui = client.gui
        self.skeleton = self.arrows = False
        self._ask, self._redraw = ask, redraw
        self._selected: int | str | None = None
        gui.add_markdown(HELP)
        self._note = gui.add_markdown("", visible=False)
        self._state = gui.add_markdown("")
        views = gui.add_button_group("Look from", (FRONT, SIDE, TOP), hint="keys 1, 2 and 3")
        views.on_click(lambda event: see(event.target.value))
        keys: tuple[tuple[str, HotkeyKey], ...] = ((FRONT, "1"), (SIDE, "2"), (TOP, "3"))
        for name, key in keys:
            gui.add_command(f"Look from: {name}", hotkey=key).on_trigger(lambda event, name=name: see(name))
        with gui.add_folder("Constraint"):
            self._name = gui.add_markdown(NOTHING)
            self._weight = gui.add_number(
                "Weight", 1.0, min=0.0, step=0.1, hint="weight relative to the other constraints"
            )
            self._pinned = gui.add_checkbox(
                "Pinned", False, hint="fix its position, with priority over points that are not pinned"
            )
            self._arrows = gui.add_checkbox(
                "Arrows", False, hint="drag along an axis; rotate a joint by the rings"
            )
            self._turn = gui.add_button("Free its orientation", visible=False)
            self._remove = gui.add_button("Remove")
        with gui.add_folder("Constrain a joint"):
            self._joint = gui.add_dropdown("Joint", session.body.skeleton.names)
            joint = gui.add_button("Constrain")
            skeleton = gui.add_checkbox("Show joints", False, hint="click one to constrain it")
        with gui.add_folder("Solver"):
            self._solver = gui.add_dropdown("Solver", tuple(SOLVERS))
            self._limits = gui.add_checkbox("Joint limits", False, disabled=session.limits is None)
            self._prior = gui.add_checkbox("Pose prior", False)
            self._root = gui.add_checkbox("Fix the root", False)
        with gui.add_folder("Edit"):
            self._undo, self._redo = gui.add_button("Undo"), gui.add_button("Redo")
            reset, clear = gui.add_button("Reset the pose"), gui.add_button("Remove all")
        with gui.add_folder("Files"):
            for label, suffix in (
                ("Save pose .npz", ".npz"), ("Save pose .bvh", ".bvh"), ("Save constraints", ".json"),
            ):  # fmt: skip
                gui.add_button(label).on_click(lambda event, suffix=suffix: save(suffix))
            upload = gui.add_upload_button("Load pose or constraints")
        upload.on_upload(lambda event: load(event.target.value.name, event.target.value.content))
        joint.on_click(lambda event: hold(self._joint.value))
        self._undo.on_click(lambda event: ask(ik.undo))
        self._redo.on_click(lambda event: ask(ik.redo))
        reset.on_click(lambda event: ask(ik.reset_pose))
        clear.on_click(lambda event: ask(ik.remove_all))
        self._remove.on_click(lambda event: self._of_selected(ik.remove_constraint))
        self._turn.on_click(lambda event: self._of_selected(ik.free_orientation))
        # these are called for values set by the program, too; only a browser's event has a client
        self._weight.on_update(lambda event: event.client and self._of_selected(ik.weigh, event.target.value))
        self._pinned.on_update(lambda event: event.client and self._of_selected(ik.pin, event.target.value))
        self._arrows.on_update(lambda event: self._see(arrows=event.target.value))
        skeleton.on_update(lambda event: self._see(skeleton=event.target.value))
        self._solver.on_update(lambda event: event.client and self._set(solver=SOLVERS[event.target.value]))
        self._limits.on_update(lambda event: event.client and self._set(keep_limits=event.target.value))
        self._prior.on_update(lambda event: event.client and self._set(use_prior=event.target.value))
        self._root.on_update(lambda event: event.client and self._set(hold_root=event.target.value))
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda event: ask(ik.undo))
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(lambda event: ask(ik.redo))

    def draw(self, session: IkSession, selected: int | str | None, note: str) -> None:
        """Show the state of a session, and an error message."""
        self._selected = selected
        chosen = next((one for one in session.state.constraints if one.point == selected), None)
        _put(self._note, "content", as_markdown(note))
        _put(self._note, "visible", bool(note))
        _put(self._state, "content", _told(session))
        self._draw_chosen(chosen)
        settings = session.state.settings
        _put(self._solver, "value", next(label for label, name in SOLVERS.items() if name == settings.solver))
        _put(self._limits, "value", settings.keep_limits and session.limits is not None)
        _put(self._prior, "value", settings.use_prior)
        _put(self._root, "value", settings.hold_root)
        _put(self._undo, "disabled", not session.past and session.grabbed is None)
        _put(self._redo, "disabled", not session.future)

    def _draw_chosen(self, chosen: Constraint | None) -> None:
        _put(
            self._name, "content", NOTHING if chosen is None else f"**{as_markdown(describe(chosen.point))}**"
        )
        for knob in (self._weight, self._pinned, self._remove):
            _put(knob, "disabled", chosen is None)
        _put(self._turn, "visible", chosen is not None and chosen.orientation is not None)
        if chosen is not None:
            _put(self._weight, "value", chosen.weight)
            _put(self._pinned, "value", chosen.pinned)

    def _of_selected(self, verb: Callable[..., IkSession], *values) -> None:
        point = self._selected
        if point is not None:
            self._ask(lambda session: verb(session, point, *values))

    def _set(self, **changes) -> None:
        def changed(session: IkSession) -> IkSession:
            settings: IkSettings = session.state.settings._replace(**changes)
            return ik.change_settings(session, settings)

        self._ask(changed)

    def _see(self, **changes: bool) -> None:
        for name, value in changes.items():
            setattr(self, name, value)
        self._redraw()


def _told(session: IkSession) -> str:
    count = len(session.state.constraints)
    if not count:
        return "No constraints."
    apart = 1000 * max(ik.distances(session))
    many = "1 constraint" if count == 1 else f"{count} constraints"
    return f"{many}, {apart:.1f} mm from its target." if count == 1 else f"{many}, at most {apart:.1f} mm from their targets."  # fmt: skip


def _put(knob: Any, name: str, value: Any) -> None:
    """Set a value only if it differs, as every assignment is sent to the browser."""
    if getattr(knob, name) != value:
        setattr(knob, name, value)
