"""The viewer in a real browser: what is asked for there arrives there, and nowhere else."""

import dataclasses
import time

import jax
import numpy as np
import pytest
from browser import chromium, shown, vertices, wait_for_node, wait_for_vertex  # noqa: F401
from helpers import chain_body, random_pose

from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Motion, stack_poses
from jaxcap.cli.track.frame_records import pack, pose_layout, row_template, row_width
from jaxcap.io.archives.journal import create_journal
from jaxcap.io.meshes.clouds import NO_FACES, Scans
from jaxcap.tracking.track_frame import make_tracker
from jaxcap.view.app import serve_contents
from jaxcap.view.contents import Contents, make_take
from jaxcap.view.figures.clouds import DisplayClouds
from jaxcap.view.live import follow_run
from jaxcap.view.notebook import show
from jaxcap.view.windows import controls
from jaxcap.view.windows.serve import address, close_server, open_server

SURFACE = "/0/body/surface"


@pytest.fixture(scope="module")
def motion() -> Motion:
    rng, skeleton = np.random.default_rng(5), chain_body().skeleton
    return stack_poses([random_pose(skeleton, rng, 0.3) for _ in range(40)], rate=20.0)


@pytest.fixture(scope="module")
def posed(motion) -> np.ndarray:
    return np.asarray(posed_vertices(chain_body(), motion.poses))


@pytest.fixture(scope="module")
def server(motion, posed):
    """A body in motion, with scans that are 10 mm off."""
    body = chain_body()
    rng = np.random.default_rng(6)
    shift = [0.01 * rng.normal(size=posed.shape[1:]) for _ in posed]
    scans = Scans([f"scan{i}" for i in range(len(posed))], lambda i: (posed[i] + shift[i], None, NO_FACES))
    server = open_server(0)
    take = make_take("a take", body.skeleton, body, motion)
    serve_contents(server, Contents(takes=[take], clouds=[DisplayClouds(scans)]))
    yield server
    close_server(server)


@pytest.fixture(scope="module")
def window(server) -> str:
    """The address of that."""
    return address(server)


def test_a_scrub_brings_the_frame_and_changes_the_picture(chromium, window, posed):  # noqa: F811
    page = chromium(window)
    wait_for_node(page, SURFACE)
    wait_for_vertex(page, SURFACE, 0, posed[0, 0])
    before = page.screenshot()
    page.locator("[role=slider]").first.press("End")
    wait_for_vertex(page, SURFACE, 47, posed[-1, 47])
    np.testing.assert_allclose(vertices(page, SURFACE), posed[-1], atol=1e-5)
    page.wait_for_timeout(500)
    assert page.screenshot() != before
    page.locator("[role=slider]").first.press("ArrowLeft")
    wait_for_vertex(page, SURFACE, 0, posed[-2, 0])
    page.close()


def test_it_plays_and_stops(chromium, window, posed, monkeypatch):  # noqa: F811
    # the slider does not follow while it plays: where it stands it has to
    monkeypatch.setattr(controls, "SLIDER_RATE", 0.01)
    page = chromium(window)
    wait_for_node(page, SURFACE)
    page.get_by_role("button", name="Play").click()
    seen = set()
    deadline = time.monotonic() + 20
    while len(seen) < 5 and time.monotonic() < deadline:
        here = vertices(page, SURFACE)
        apart = np.abs(posed - here).max((1, 2))
        # every vertex of one frame, never a part of the next one
        assert apart.min() < 1e-5
        seen.add(int(apart.argmin()))
    assert len(seen) >= 5
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").wait_for()
    page.wait_for_timeout(300)
    still = vertices(page, SURFACE)
    page.wait_for_timeout(300)
    np.testing.assert_array_equal(vertices(page, SURFACE), still)
    frame = int(np.abs(posed - still).max((1, 2)).argmin())
    page.wait_for_function(
        "frame => +document.querySelector('[role=slider]').getAttribute('aria-valuenow') === frame", arg=frame
    )
    page.close()


def test_single_frames_views_and_clicks(chromium, server, window, posed):  # noqa: F811
    page = chromium(window)
    wait_for_vertex(page, SURFACE, 0, posed[0, 0])
    page.get_by_role("button", name="Next").click()
    wait_for_vertex(page, SURFACE, 0, posed[1, 0])
    page.keyboard.press("n")
    wait_for_vertex(page, SURFACE, 0, posed[2, 0])
    page.get_by_role("button", name="Back").click()
    wait_for_vertex(page, SURFACE, 0, posed[1, 0])
    np.testing.assert_allclose(vertices(page, SURFACE), posed[1], atol=1e-5)
    # the eye is where its name says
    camera = server.get_clients()[max(server.get_clients())].camera

    def wait_to_look_along(axis: int) -> None:
        end = time.monotonic() + 60
        while (back := camera.position - camera.look_at)[axis] < 0.999 * np.linalg.norm(back):
            assert time.monotonic() < end
            page.wait_for_timeout(50)

    for name, axis in (("Front", 2), ("Side", 0), ("Top", 1)):
        page.get_by_role("button", name=name, exact=True).click()
        wait_to_look_along(axis)
    page.keyboard.press("1")
    wait_to_look_along(2)
    page.mouse.click(600, 30)
    page.get_by_text("There is nothing where you clicked.").wait_for()
    page.close()


def test_two_users_do_not_see_each_others_edits(chromium, window, posed):  # noqa: F811
    first, second = chromium(window), chromium(window)
    for page in (first, second):
        wait_for_vertex(page, SURFACE, 0, posed[0, 0])
    first.locator("[role=slider]").first.press("End")
    first.get_by_label("Skeleton").check()
    wait_for_vertex(first, SURFACE, 0, posed[-1, 0])
    first.wait_for_function("window.__viserMutable.nodeRefFromName['/0/skeleton'].visible")
    np.testing.assert_allclose(vertices(second, SURFACE), posed[0], atol=1e-5)
    assert not shown(second, "/0/skeleton/bones")
    first.close()
    second.close()


def test_what_is_hidden_is_not_sent(chromium, window, posed):  # noqa: F811
    page = chromium(window)
    wait_for_vertex(page, SURFACE, 0, posed[0, 0])
    page.get_by_label("Surface").uncheck()
    page.wait_for_function("!window.__viserMutable.nodeRefFromName['/0/body'].visible")
    page.get_by_label("Skeleton").check()
    page.locator("[role=slider]").first.press("End")
    # the skeleton has come, so the surface would have, too
    page.wait_for_function("window.__viserMutable.nodeRefFromName['/0/skeleton'].visible")
    page.wait_for_timeout(500)
    np.testing.assert_allclose(vertices(page, SURFACE), posed[0], atol=1e-5)
    page.get_by_label("Surface").check()
    wait_for_vertex(page, SURFACE, 0, posed[-1, 0])
    page.close()


def test_distances_paint_the_surface_in_bands(chromium, window):  # noqa: F811
    page = chromium(window)
    wait_for_node(page, SURFACE)
    page.get_by_label("Colours").click()
    page.get_by_role("option", name="distance to the scan").click()
    page.wait_for_function("!window.__viserMutable.nodeRefFromName['/0/body/surface'].visible")
    bands = [name for name in (f"/0/body/colour{band}" for band in range(13)) if shown(page, name)]
    assert len(bands) > 2
    page.close()


def test_a_browser_that_closes_is_let_go(chromium, window, capfd):  # noqa: F811
    page = chromium(window)
    wait_for_node(page, SURFACE)
    page.get_by_role("button", name="Play").click()
    page.close()
    time.sleep(1.5)
    assert capfd.readouterr().err == ""


def test_a_running_track_appears_frame_by_frame(chromium, tmp_path, motion, posed):  # noqa: F811
    body = chain_body()
    tracker = make_tracker(body)

    def record(frame: int) -> np.ndarray:
        return pack(dataclasses.replace(row_template(tracker), pose=motion[frame]), 0.1)

    server = open_server(0)
    with create_journal(
        tmp_path / "journal", pose_layout(body.skeleton), row_width(row_template(tracker))
    ) as journal:
        followers = serve_contents(server, Contents(takes=[follow_run(tmp_path, body)]))
        page = chromium(address(server))
        wait_for_vertex(page, SURFACE, 0, body.vertices[0])
        journal.append(record(3))
        wait_for_vertex(page, SURFACE, 0, posed[3, 0])
        journal.append(record(4))
        wait_for_vertex(page, SURFACE, 0, posed[4, 0])
        # half of a record is none
        with open(journal.path, "ab") as file:
            file.write(record(5).tobytes()[:200])
        page.wait_for_timeout(600)
        np.testing.assert_allclose(vertices(page, SURFACE), posed[4], atol=1e-5)
        assert followers[0].error == ""
    # begun anew with another body: a window that stands still tells it
    other = {**pose_layout(body.skeleton), "joints": ["a"]}
    with create_journal(tmp_path / "journal", other, row_width(row_template(tracker))) as journal:
        journal.append(record(6))
        page.get_by_text("this run is of another body").wait_for()
    with create_journal(
        tmp_path / "journal", pose_layout(body.skeleton), row_width(row_template(tracker))
    ) as journal:
        journal.append(record(7))
        wait_for_vertex(page, SURFACE, 0, posed[7, 0])
        page.get_by_text("this run is of another body").wait_for(state="hidden")
        page.close()
    for follower in followers:
        follower.stop()
    close_server(server)
    jax.clear_caches()


def test_a_recording_plays_without_a_server(chromium, tmp_path, motion, posed):  # noqa: F811
    (tmp_path / "take.html").write_text(show(chain_body(), motion).page(frames=10))
    page = chromium((tmp_path / "take.html").as_uri())
    wait_for_node(page, SURFACE)
    seen = set()
    deadline = time.monotonic() + 30
    while len(seen) < 3 and time.monotonic() < deadline:
        apart = np.abs(posed[::4] - vertices(page, SURFACE)).max((1, 2))
        assert apart.min() < 1e-5
        seen.add(int(apart.argmin()))
    assert len(seen) >= 3
    page.close()
