"""The viewer's server and its verb: ports, what is missing, what is wrong, and how it ends."""

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request

import numpy as np
import pytest
from command_line import PYTHON, fails
from helpers import chain_body, random_pose

from jaxcap.body.pose import stack_poses
from jaxcap.errors import InputError
from jaxcap.io.archives.npz import save_body, save_motion
from jaxcap.io.meshes.clouds import NO_FACES, Scans
from jaxcap.view.contents import make_take
from jaxcap.view.figures.clouds import DisplayClouds
from jaxcap.view.figures.figure import BodyFigure
from jaxcap.view.figures.skeleton_figure import SkeletonFigure
from jaxcap.view.notebook import show
from jaxcap.view.windows.column import DISTANCE, Choice, Column
from jaxcap.view.windows.serve import address, close_server, open_server


@pytest.fixture
def taken():
    """A port that another program listens at."""
    with socket.socket() as door:
        door.bind(("127.0.0.1", 0))
        door.listen(1)
        yield door.getsockname()[1]


def test_a_server_says_nothing_and_gives_its_port_back(capfd):
    server = open_server(0)
    url = address(server)
    assert urllib.request.urlopen(url, timeout=20).status == 200
    port = server.get_port()
    close_server(server)
    close_server(server)
    again = open_server(port)
    assert again.get_port() == port
    close_server(again)
    assert capfd.readouterr() == ("", "")


def test_what_other_threads_print_is_not_lost(capfd):
    stop, lines = threading.Event(), []

    def talk() -> None:
        while not stop.is_set():
            lines.append(str(len(lines)))
            sys.stdout.write(lines[-1] + "\n")
            time.sleep(0.001)

    thread = threading.Thread(target=talk)
    thread.start()
    close_server(open_server(0))
    stop.set()
    thread.join()
    assert capfd.readouterr().out.split() == lines


def test_each_server_ends_in_silence_with_its_program():
    code = (
        "from jaxcap.view.windows.serve import close_server, open_server\n"
        "first, second, third = (open_server(0) for _ in range(3))\n"
        "close_server(second)"
    )
    ended = subprocess.run(
        [PYTHON, "-c", code], capture_output=True, text=True, env=_environment(), timeout=120
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, "", "")


def test_a_taken_port_is_told_and_not_gone_past(taken):
    with pytest.raises(InputError, match=f"port {taken}: another program .* --port"):
        open_server(taken)
    with pytest.raises(InputError, match="65535"):
        open_server(70_000)
    with pytest.raises(InputError, match="not an address of this machine"):
        open_server(0, "203.0.113.7")


def test_without_a_port_another_one_is_found(monkeypatch, taken):
    monkeypatch.setattr("jaxcap.view.windows.serve.PORT", taken)
    server = open_server()
    assert server.get_port() != taken
    close_server(server)


def test_without_the_extra_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=r'pip install -e ".\[view\]"'):
        open_server(0)


def test_figures_send_what_changes_and_nothing_else():
    server = open_server(0)
    body = chain_body()
    sent: list[tuple[str, list[str]]] = []
    figure = BodyFigure(server.scene, "/body", body)
    push = server._websock_server.queue_message

    def note(message):
        sent.append((type(message).__name__, sorted(getattr(message, "updates", {}))))
        push(message)

    server._websock_server.queue_message = note
    figure.show(body.vertices + 1.0)
    assert sent == [("SceneNodeUpdateMessage", ["vertices"])]
    sent.clear()
    figure.show(body.vertices + 1.0)
    assert sent == []
    figure.visible = False
    sent.clear()
    figure.show(body.vertices)
    figure.colours(np.arange(len(body.vertices)) % 3, np.eye(3, dtype=np.uint8) * 255)
    assert sent == []
    figure.visible = True
    assert ("SceneNodeUpdateMessage", ["vertices"]) in sent
    close_server(server)


def test_painted_parts_are_the_whole_surface():
    server = open_server(0)
    body = chain_body()
    figure = BodyFigure(server.scene, "/body", body)
    faces = np.asarray(body.faces)
    for seed in range(3):
        classes = np.random.default_rng(seed).integers(0, 4, len(body.vertices))
        figure.colours(classes, (60 * np.arange(12).reshape(4, 3) % 255).astype(np.uint8))
        figure.show(body.vertices + 0.1 * seed)
        painted = []
        for number, part in enumerate(figure._parts):
            mesh = part._mesh
            if mesh.visible:
                assert mesh.faces.max() < len(mesh.vertices)
                middle = np.sort(classes[faces], 1)[:, 1] == number
                np.testing.assert_allclose(
                    mesh.vertices[mesh.faces],
                    np.asarray(body.vertices + 0.1 * seed)[faces[middle]],
                    atol=1e-6,
                )
                painted.append(middle)
        assert np.sum(painted, 0).min() == np.sum(painted, 0).max() == 1
        assert not figure._whole.visible
    figure.colours(None)
    assert figure._whole.visible
    close_server(server)


def test_a_body_without_faces_is_its_points():
    server = open_server(0)
    body = chain_body()
    bare = type(body)(body.skeleton, body.skin, body.vertices, body.faces[:0])
    figure = BodyFigure(server.scene, "/body", bare)
    figure.show(bare.vertices + 1.0)
    np.testing.assert_allclose(figure._whole.points, np.asarray(body.vertices) + 1.0, atol=1e-6)
    skeleton = SkeletonFigure(server.scene, "/bones", body.skeleton)
    skeleton.frames = skeleton.names = True
    skeleton.show(body.skeleton.centres + 1.0, np.tile(2.0 * np.eye(3), (body.skeleton.num_joints, 1, 1)))
    # a rest pose's frames are the joints' own, whatever the scale
    turned = np.asarray(body.skeleton.orientations)
    alike = np.abs(np.sum(skeleton._axes.batched_wxyzs * turned, 1))
    np.testing.assert_allclose(alike, 1.0, atol=1e-5)
    close_server(server)


def test_a_scan_that_is_being_written_is_told_and_tried_again():
    body, there = chain_body(), []

    def read(frame):
        if not there:
            raise InputError("scan.ply: this is not a whole file.")
        return np.asarray(body.vertices), None, NO_FACES

    server = open_server(0)
    take = make_take("take", body.skeleton, body)
    column = Column(server.scene, "/0", 0, take, DisplayClouds(Scans(["scan.ply"], read)))
    look = column.appearance(0.0, 0, Choice(colours=DISTANCE))
    column.draw(look, Choice(colours=DISTANCE))
    assert look.error == "scan.ply: this is not a whole file." and look.points is None
    there.append(True)
    look = column.appearance(0.0, 0, Choice(colours=DISTANCE))
    column.draw(look, Choice(colours=DISTANCE))
    assert look.error == "" and column.scan is not None and column.scan.node.visible
    close_server(server)


def test_a_program_shows_what_it_holds():
    body = chain_body()
    motion = stack_poses([random_pose(body.skeleton, np.random.default_rng(i)) for i in range(7)])
    player = show(body, motion, [np.asarray(body.vertices)] * 7, heat=True)
    url = player.open(0, browser=False)
    assert urllib.request.urlopen(url, timeout=20).status == 200
    player.close()
    short, long = player.page(frames=2), player.page()
    assert long.startswith("<!") and "__VISER_EMBED_DATA__" in long
    assert len(short) < len(long)
    with pytest.raises(ValueError, match="9"):
        show(body, type(motion[0])(motion[0].translations[:2], motion[0].rotations[:2], motion[0].scale))


def test_wrong_requests_end_in_a_sentence(capsys, tmp_path, taken):
    body = chain_body()
    save_body(tmp_path / "body.npz", body)
    save_motion(tmp_path / "motion.npz", stack_poses([random_pose(body.skeleton, np.random.default_rng(0))]))
    here = str(tmp_path / "body.npz")
    assert f"port {taken}" in fails(capsys, "view", here, "--port", taken, "--no-browser")
    assert "no such file" in fails(capsys, "view", tmp_path / "none.npz")
    assert "--spacing is -1" in fails(capsys, "view", here, "--spacing", -1)
    assert "--rate is 0" in fails(capsys, "view", here, "--rate", 0)
    assert "There is nothing to show" in fails(capsys, "view")
    np.savez(tmp_path / "numbers.npz", loss=np.zeros(3))
    assert "contains no geometry" in fails(capsys, "view", tmp_path / "numbers.npz")
    assert "--body" in fails(capsys, "view", tmp_path / "motion.npz")
    told = fails(capsys, "view", tmp_path / "motion.npz", "--body", "human:low")
    assert "motion.npz" in told and "human:low" in told


def test_a_window_ends_with_ctrl_c(tmp_path):
    save_body(tmp_path / "body.npz", chain_body())
    # where tests run in the background, a shell has children ignore Ctrl-C
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    code = listen + "from jaxcap.cli import main; main()"
    command = [PYTHON, "-c", code, "view", "body.npz", "--no-browser", "--port", "0"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=_environment()
    ) as program:
        assert program.stdout is not None
        line = program.stdout.readline()
        url = re.search(r"http://127\.0\.0\.1:\d+/\S+/", line)
        assert url is not None, line
        assert urllib.request.urlopen(url.group(), timeout=30).status == 200
        program.send_signal(signal.SIGINT)
        try:
            out, error = program.communicate(timeout=60)
        finally:
            program.kill()
    assert program.returncode == 130
    # words while it starts depend on how busy the machine is
    assert out == "" and error.strip().splitlines()[-1] == "jaxcap: stopped" and "Traceback" not in error


def _environment() -> dict[str, str]:
    return {**os.environ, "JAX_PLATFORMS": "cpu"}
