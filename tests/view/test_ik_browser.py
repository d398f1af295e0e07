"""Inverse kinematics in a real browser: a point is clicked and dragged, the vertex arrives, nobody else sees it."""

import io
import json
import time

import jax.numpy as jnp
import numpy as np
import pytest
from browser import chromium, vertices, wait_for_node
from PIL import Image

import jaxcap as jc
from benchmarks.view._browser import project_to_page as on_page
from benchmarks.view._browser import wait_for_camera
from jaxcap.edit.ik import session as ik
from jaxcap.edit.ik.solve_ik import SOLVERS
from jaxcap.view.ik.controls import SOLVERS as LABELS
from jaxcap.view.ik.handles import REACHED_COLOUR
from jaxcap.view.ik.window import serve_ik
from jaxcap.view.windows.serve import address, close_server, open_server

__all__ = ["chromium"]

SURFACE = "/body/surface"
#: seconds that a busy machine may take to compile
PATIENCE = 300.0


def wait(happened, seconds: float = 60.0):
    """Until something is true; returns it."""
    end = time.monotonic() + seconds
    while not (found := happened()):
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
    return found


@pytest.fixture(scope="module")
def body() -> jc.Body:
    return jc.human(resolution="low", joints="tracking")


@pytest.fixture(scope="module")
def served(body):
    """The server and the windows that are open."""
    server = open_server(0)
    yield server, serve_ik(server, ik.begin_session(body))
    close_server(server)


def open_window(chromium, served):
    server, windows = served
    before = set(windows)
    page = chromium(address(server))
    window = wait(lambda: set(windows) - before).pop()
    wait(lambda: not window.note, PATIENCE)
    wait_for_node(page, SURFACE)
    wait_for_camera(page, window.client.camera, window.middle)
    return page, window


def pixel(window, place) -> np.ndarray:
    """Where a place is on the screen."""
    return on_page(window.client.camera, place)


def hand_of(body) -> int:
    """A vertex of the right hand's back, which the eye sees."""
    places = np.asarray(body.vertices)
    wrist = np.asarray(body.skeleton.centres)[body.skeleton.index("RightHand")]
    near = np.flatnonzero(np.linalg.norm(places - wrist, axis=1) < 0.08)
    return int(near[np.argmax(places[near, 2])])


def drag(page, start, end, steps: int = 8) -> None:
    page.mouse.move(*start)
    page.mouse.down()
    for share in np.linspace(0, 1, steps + 1)[1:]:
        page.mouse.move(*(start + share * (end - start)))
        time.sleep(0.05)


def colour_at(page, place) -> np.ndarray:
    picture = np.asarray(Image.open(io.BytesIO(page.screenshot())).convert("RGB"), float)
    x, y = np.round(place).astype(int)
    return picture[y - 1 : y + 2, x - 1 : x + 2].mean((0, 1))


def colour_without_mouse(page, place) -> np.ndarray:
    """The colour with the mouse elsewhere: a ball under the mouse is lit up, and stays so if a busy page misses
    that the mouse has left, so that it is moved each time."""
    page.mouse.move(5, 300)
    page.mouse.move(9, 304)
    return colour_at(page, place)


def looks_like(colour, wanted) -> bool:
    """The same hue under whatever light."""
    a, b = (np.asarray(c, float) - np.mean(c) for c in (colour, wanted))
    return a @ b > 0.9 * np.linalg.norm(a) * np.linalg.norm(b) and np.linalg.norm(a) > 15


def test_every_solver_has_a_label():
    assert sorted(LABELS.values()) == sorted(SOLVERS)


def test_a_point_is_clicked_dragged_and_arrives(chromium, served, body):
    page, window = open_window(chromium, served)
    other, bystander = open_window(chromium, served)
    page.mouse.click(600, 30)
    page.get_by_text("There is nothing where you clicked").wait_for()
    assert window.session.state.constraints == () and not bystander.note
    start = pixel(window, body.vertices[hand_of(body)])
    page.mouse.click(*start)
    (held,) = wait(lambda: window.session.state.constraints)
    # a hand hits a ball that is 24 pixels wide
    beside = np.add(held.target, [window.handles.radius, 0.0, 0.0])
    assert np.linalg.norm(pixel(window, beside) - pixel(window, held.target)) > 10
    # the corner nearest to where the mouse was
    assert np.linalg.norm(pixel(window, held.target) - start) < 8
    # nothing has moved yet
    np.testing.assert_allclose(vertices(page, SURFACE), body.vertices, atol=1e-6)

    wait(lambda: "/handles/1/ball" in page.evaluate("Object.keys(window.__viserMutable.nodeRefFromName)"))
    start = pixel(window, held.target)
    end = start + [-50.0, -45.0]
    drag(page, start, end)
    wait(lambda: window.session.drag_start is not None)
    page.mouse.up()
    wait(lambda: window.session.drag_start is None and len(window.session.undo_states) == 2)
    session = window.session
    target = ik.find_constraint(session, held.point).target
    assert np.linalg.norm(pixel(window, target) - end) < 3
    assert np.linalg.norm(np.subtract(target, held.target)) > 0.1
    # the session, the page and the picture say that the vertex is there
    assert np.linalg.norm(np.subtract(ik.point_position(session, held.point), target)) < 0.01
    wait(lambda: np.linalg.norm(vertices(page, SURFACE)[held.point] - target) < 0.01)
    wait(lambda: looks_like(colour_without_mouse(page, end), REACHED_COLOUR), PATIENCE)
    assert not looks_like(colour_at(page, start), REACHED_COLOUR)

    # the other browser has seen nothing of it
    assert bystander.session.state.constraints == ()
    np.testing.assert_allclose(vertices(other, SURFACE), body.vertices, atol=1e-6)
    assert not looks_like(colour_at(other, end), REACHED_COLOUR)

    page.get_by_role("button", name="Undo").click()
    wait(lambda: len(window.session.undo_states) == 1)
    wait(lambda: np.abs(vertices(page, SURFACE) - np.asarray(body.vertices)).max() < 1e-5)
    page.close()
    other.close()


def test_files_go_to_the_browser_and_come_from_it(chromium, served, body, tmp_path):
    page, window = open_window(chromium, served)
    names = body.skeleton.names
    constraints = [{"joint": "LeftArm", "target": [0.3, 0.6, 0.1], "pinned": True}]
    path = tmp_path / "held.json"
    path.write_text(json.dumps({"format": "jaxcap constraints", "version": 1, "constraints": constraints}))
    chooser = page.locator("input[type=file]").first
    chooser.set_input_files(str(path))
    (held,) = wait(lambda: window.session.state.constraints)
    assert (held.point, held.pinned) == ("LeftArm", True)
    arm = names.index("LeftArm")
    wait(lambda: np.linalg.norm(window.shown.joints[arm] - [0.3, 0.6, 0.1]) < 0.01)

    with page.expect_download() as saved:
        page.get_by_role("button", name="Save pose .npz").click()
    saved.value.save_as(tmp_path / "pose.npz")
    pose = jc.load_motion(tmp_path / "pose.npz", body.skeleton)[0]
    np.testing.assert_allclose(pose.rotations, window.session.state.pose.rotations, atol=1e-6)

    path = path.with_name("wrong.json")
    path.write_text("{}")
    chooser.set_input_files(str(path))
    page.get_by_text("wrong.json: this is not a file of constraints").wait_for()
    assert window.session.state.constraints == (held,)

    # the surface lets the joints inside it be seen
    opacity = f"""() => {{
        let found = 1;
        window.__viserMutable.nodeRefFromName['{SURFACE}'].traverse(o => {{ if (o.material) found = o.material.opacity; }});
        return found;
    }}"""
    assert page.evaluate(opacity) == 1
    page.get_by_label("Show joints").check()
    page.wait_for_function(f"({opacity})() < 1")
    page.get_by_label("Show joints").uncheck()
    page.wait_for_function(f"({opacity})() === 1")
    page.close()


def test_a_browser_that_closes_in_a_drag_leaves_no_trace(chromium, served, body, capfd):
    page, window = open_window(chromium, served)
    windows = served[1]
    start = pixel(window, body.vertices[hand_of(body)])
    page.mouse.click(*start)
    (held,) = wait(lambda: window.session.state.constraints)
    wait(lambda: "/handles/1/ball" in page.evaluate("Object.keys(window.__viserMutable.nodeRefFromName)"))
    start = pixel(window, held.target)
    capfd.readouterr()
    drag(page, start, start + [-200.0, -100.0])
    page.close()
    wait(lambda: window not in windows)
    told = "".join(capfd.readouterr())
    assert "Traceback" not in told and "Exception" not in told, told


class Failing(jc.AbstractEnergy):
    """A prior of somebody's own, with a fault in it."""

    def residual(self, posed):
        raise RuntimeError("this prior has a fault")


def test_a_solver_that_fails_is_told_in_the_window(chromium, body, capfd):
    server = open_server(0)
    windows = serve_ik(server, ik.begin_session(body, prior=Failing()))
    page = chromium(address(server))
    page.get_by_text("this prior has a fault").wait_for()
    (window,) = windows
    np.testing.assert_array_equal(window.session.state.pose.rotations, window.session.initial_pose.rotations)
    page.close()
    close_server(server)
    assert "Traceback" not in "".join(capfd.readouterr())


def test_a_body_without_faces_is_dragged_by_its_points(chromium, body):
    chosen = jnp.arange(0, len(body.vertices), 5)
    bare = jc.Body(body.skeleton, body.skin.take(chosen), body.vertices[chosen], jnp.zeros((0, 3), int))
    server = open_server(0)
    windows = serve_ik(server, ik.begin_session(bare))
    page = chromium(address(server))
    (window,) = wait(lambda: list(windows))
    wait(lambda: not window.note, PATIENCE)
    wait_for_node(page, "/body/points")
    wait_for_camera(page, window.client.camera, window.middle)
    page.mouse.click(*pixel(window, bare.vertices[hand_of(bare)]))
    (held,) = wait(lambda: window.session.state.constraints)
    assert np.linalg.norm(np.subtract(held.target, bare.vertices[hand_of(bare)])) < 0.05
    page.close()
    close_server(server)
