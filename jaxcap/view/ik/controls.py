"""The controls of inverse kinematics in one window. They request edits and show the state of a session."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ...edit.ik import session as ik
from ...edit.ik.constraints import Constraint, describe_point
from ...edit.ik.session import IkSession, IkSettings
from ...edit.ik.solve_ik import Solver
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
NO_SELECTION = "no constraint is selected"


class IkControls:
    """**Arguments:** `client`; the `session` that sets the initial values; `send_edit` receives an
    edit; `constrain` a point to constrain; `redraw` is called if only the display changes; `save` takes a
    suffix, `load` a file's name and content; `set_view` the name of a direction to look from."""

    def __init__(
        self,
        client: ClientHandle,
        session: IkSession,
        send_edit: Callable[[ik.Edit], None],
        constrain: Callable[[int | str], None],
        redraw: Callable[[], None],
        save: Callable[[str], None],
        load: Callable[[str, bytes], None],
        set_view: Callable[[str], None],
    ):
        gui = client.gui
        self.skeleton = self.arrows = False
        self._send_edit, self._redraw = send_edit, redraw
        self._selected: int | str | None = None
        gui.add_markdown(HELP)
        self._note = gui.add_markdown("", visible=False)
        self._state = gui.add_markdown("")
        views = gui.add_button_group("Look from", (FRONT, SIDE, TOP), hint="keys 1, 2 and 3")
        views.on_click(lambda event: set_view(event.target.value))
        keys: tuple[tuple[str, HotkeyKey], ...] = ((FRONT, "1"), (SIDE, "2"), (TOP, "3"))
        for name, key in keys:
            gui.add_command(f"Look from: {name}", hotkey=key).on_trigger(
                lambda event, name=name: set_view(name)
            )
        with gui.add_folder("Constraint"):
            self._name = gui.add_markdown(NO_SELECTION)
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
        joint.on_click(lambda event: constrain(self._joint.value))
        self._undo.on_click(lambda event: send_edit(ik.undo))
        self._redo.on_click(lambda event: send_edit(ik.redo))
        reset.on_click(lambda event: send_edit(ik.reset_pose))
        clear.on_click(lambda event: send_edit(ik.remove_constraints))
        self._remove.on_click(lambda event: self._edit_selected(ik.remove_constraint))
        self._turn.on_click(lambda event: self._edit_selected(ik.remove_orientation))
        # these are called for values set by the program, too; only a browser's event has a client
        self._weight.on_update(
            lambda event: event.client and self._edit_selected(ik.set_weight, event.target.value)
        )
        self._pinned.on_update(
            lambda event: event.client and self._edit_selected(ik.set_pinned, event.target.value)
        )
        self._arrows.on_update(lambda event: self._change_display(arrows=event.target.value))
        skeleton.on_update(lambda event: self._change_display(skeleton=event.target.value))
        self._solver.on_update(
            lambda event: event.client and self._change_settings(solver=SOLVERS[event.target.value])
        )
        self._limits.on_update(
            lambda event: event.client and self._change_settings(keep_limits=event.target.value)
        )
        self._prior.on_update(
            lambda event: event.client and self._change_settings(use_prior=event.target.value)
        )
        self._root.on_update(
            lambda event: event.client and self._change_settings(fix_root=event.target.value)
        )
        gui.add_command("Undo", hotkey="Z", modifier="cmd/ctrl").on_trigger(lambda event: send_edit(ik.undo))
        gui.add_command("Redo", hotkey="Z", modifier="cmd/ctrl+shift").on_trigger(
            lambda event: send_edit(ik.redo)
        )

    def draw(self, session: IkSession, selected: int | str | None, note: str) -> None:
        """Show the state of a session, and an error message."""
        self._selected = selected
        chosen = next((one for one in session.state.constraints if one.point == selected), None)
        _set_if_changed(self._note, "content", as_markdown(note))
        _set_if_changed(self._note, "visible", bool(note))
        _set_if_changed(self._state, "content", _status_text(session))
        self._draw_chosen(chosen)
        settings = session.state.settings
        _set_if_changed(
            self._solver, "value", next(label for label, name in SOLVERS.items() if name == settings.solver)
        )
        _set_if_changed(self._limits, "value", settings.keep_limits and session.limits is not None)
        _set_if_changed(self._prior, "value", settings.use_prior)
        _set_if_changed(self._root, "value", settings.fix_root)
        _set_if_changed(self._undo, "disabled", not session.undo_states and session.drag_start is None)
        _set_if_changed(self._redo, "disabled", not session.redo_states)

    def _draw_chosen(self, chosen: Constraint | None) -> None:
        _set_if_changed(
            self._name,
            "content",
            NO_SELECTION if chosen is None else f"**{as_markdown(describe_point(chosen.point))}**",
        )
        for knob in (self._weight, self._pinned, self._remove):
            _set_if_changed(knob, "disabled", chosen is None)
        _set_if_changed(self._turn, "visible", chosen is not None and chosen.orientation is not None)
        if chosen is not None:
            _set_if_changed(self._weight, "value", chosen.weight)
            _set_if_changed(self._pinned, "value", chosen.pinned)

    def _edit_selected(self, edit: Callable[..., IkSession], *values) -> None:
        point = self._selected
        if point is not None:
            self._send_edit(lambda session: edit(session, point, *values))

    def _change_settings(self, **changes) -> None:
        def changed(session: IkSession) -> IkSession:
            settings: IkSettings = session.state.settings._replace(**changes)
            return ik.change_settings(session, settings)

        self._send_edit(changed)

    def _change_display(self, **changes: bool) -> None:
        for name, value in changes.items():
            setattr(self, name, value)
        self._redraw()


def _status_text(session: IkSession) -> str:
    count = len(session.state.constraints)
    if not count:
        return "No constraints."
    distance = 1000 * max(ik.target_distances(session))
    many = "1 constraint" if count == 1 else f"{count} constraints"
    return f"{many}, {distance:.1f} mm from its target." if count == 1 else f"{many}, at most {distance:.1f} mm from their targets."  # fmt: skip


def _set_if_changed(control: Any, name: str, value: Any) -> None:
    """Set a value only if it differs, as every assignment is sent to the browser."""
    if getattr(control, name) != value:
        setattr(control, name, value)
