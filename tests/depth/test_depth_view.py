"""Depth images in a window, and in words: each step from the image to the person."""

import json

import numpy as np
import pytest
from browser import chromium, shown, vertices, wait_for_node  # noqa: F401
from command_line import fails, runs
from depth_room import CAMERA, LOW, VERTICES, see

from jaxcap.depth import estimate_background
from jaxcap.depth.back_projection import measured_points
from jaxcap.io.cameras import write_cameras
from jaxcap.view.app import serve_contents
from jaxcap.view.contents import Contents
from jaxcap.view.figures.depth_layers import (
    BACKGROUND,
    CANDIDATES,
    MEASURED,
    PERSON_LAYER,
    PLANES,
    DepthLayers,
    explain_depth,
)
from jaxcap.view.windows.serve import address, close_server, open_server


@pytest.fixture(scope="module")
def room():
    """Twelve frames: a person walks behind a box, and leaves after nine of them. The last pixels of the person."""
    seen = [see([VERTICES + [step, 0.0, 0.0]]) for step in np.linspace(-0.5, 0.7, 9)]
    depths = [depth for depth, _ in seen] + [see([])[0]] * 3
    return depths, seen[0][1]


@pytest.fixture(scope="module")
def files(room, tmp_path_factory):
    folder = tmp_path_factory.mktemp("room")
    depth = (1000 * np.stack(room[0])).round().astype(np.uint16)
    np.savez(folder / "depth.npz", depth=depth)
    np.savez(folder / "empty.npz", depth=depth[-1:])
    write_cameras(folder / "cameras.json", [CAMERA])
    write_cameras(folder / "two.json", [CAMERA, CAMERA])
    return folder


def test_layers_divide_the_measured_points(room):
    depths, person = room
    background = estimate_background(CAMERA, depths[-1:], empty=True)
    layers, note = explain_depth(CAMERA, depths[0], background)
    assert note == "" and len(layers[MEASURED].points) == np.sum(depths[0] > 0)
    steps = [layers[name].points for name in (PLANES, BACKGROUND, CANDIDATES, PERSON_LAYER)]
    together = np.unique(np.concatenate(steps), axis=0)
    assert len(together) == sum(map(len, steps)) > 0.95 * len(layers[MEASURED].points)
    there = measured_points(CAMERA, np.where(person, depths[0], 0.0))
    np.testing.assert_allclose(layers[PERSON_LAYER].points.mean(0), there.mean(0), atol=0.03)
    ((size, _),) = layers[PERSON_LAYER].labels
    assert size.startswith("the person: 1.") and "floor" in [name for name, _ in layers[PLANES].labels]
    # a mask has the last word, and without a background the box is the person
    masked, _ = explain_depth(CAMERA, depths[0], None, person)
    assert len(masked[PERSON_LAYER].points) == np.sum(person)
    alone, _ = explain_depth(CAMERA, depths[0])
    found = [name.split(":")[0] for name, _ in alone[CANDIDATES].labels]
    assert "farther away than the person" in found and "too large" in found
    _, empty = explain_depth(CAMERA, depths[-1], background)
    assert empty == "This frame shows no person: no surface has the size of one."
    _, empty = explain_depth(CAMERA, depths[0], None, person & False)
    assert "the mask is empty" in empty


def test_a_window_shows_the_steps_of_each_frame(chromium, room):  # noqa: F811
    depths, _ = room
    background = estimate_background(CAMERA, depths[-1:], empty=True)
    layers = DepthLayers([CAMERA], len(depths), lambda frame: ([depths[frame]], [None]), [background])
    server = open_server(0)
    serve_contents(server, Contents(depths=[layers], cameras=[CAMERA]))
    page = chromium(address(server))
    wait_for_node(page, "/depth0/person")
    page.wait_for_function("window.__viserMutable.nodeRefFromName['/depth0/person'].visible")
    np.testing.assert_allclose(
        np.sort(vertices(page, "/depth0/person"), 0),
        np.sort(layers[0].layers[PERSON_LAYER].points, 0),
        atol=1e-4,
    )
    assert shown(page, "/depth0/floors_and_walls") and not shown(page, "/depth0/measured_points")
    page.get_by_label("Measured points").check()
    page.wait_for_function("window.__viserMutable.nodeRefFromName['/depth0/measured_points'].visible")
    page.get_by_label("Background").uncheck()
    page.wait_for_function("!window.__viserMutable.nodeRefFromName['/depth0/background'].visible")
    page.locator("[role=slider]").first.press("End")
    page.get_by_text("This frame shows no person").wait_for()
    page.wait_for_function("!window.__viserMutable.nodeRefFromName['/depth0/person'].visible")
    page.close()
    close_server(server)


def test_info_describes_the_room_and_the_person(files, capsys):
    printed = runs(capsys, "info", files / "depth.npz", "--cameras", files / "cameras.json")
    height = float(CAMERA.eye[1]) - LOW
    assert f"floor: {height:.2f} m below the camera; its normal is 0 degrees" in printed
    assert "a person was found in 9 of the 12 frames" in printed
    assert "no surface has the size of a person in frames 9, 10, 11, counted from 0" in printed
    assert "the intrinsics of the camera (--cameras) are needed" in runs(capsys, "info", files / "depth.npz")
    assert "images of one are described" in fails(
        capsys, "info", files / "depth.npz", "--cameras", files / "two.json"
    )


def test_info_suggests_the_right_scale_and_no_run_without_a_person(files, capsys):
    np.savez(files / "wall.npz", depth=np.full((1, CAMERA.height, CAMERA.width), 2000, np.uint16))
    np.savez(files / "metres.npz", depth=np.full((1, CAMERA.height, CAMERA.width), 2000.0))
    words = ["--cameras", files / "cameras.json"]
    printed = runs(capsys, "info", files / "wall.npz", *words)
    assert "next:" not in printed and "check --depth-scale (1000 units in a metre were used" in printed
    assert f"and --cameras ({files}/cameras.json)" in printed
    assert "floor: none was found, so the tilt of the camera is not known" in printed
    for given, right in (("1", ""), ("5", " --depth-scale 500")):
        printed = runs(capsys, "info", files / "wall.npz", *words, "--depth-scale", given)
        assert f"--cameras {files}/cameras.json{right} -o tracked` fits a body;" in printed, given
        assert ("its whole numbers are metres" in printed and "is 2000 m" in printed) == (given == "1")
    printed = runs(capsys, "info", files / "metres.npz", *words)
    assert "next:" not in printed and "whole numbers are millimetres" not in printed


def test_a_surface_before_an_unknown_background_may_be_furniture(files, capsys):
    printed = runs(capsys, "info", files / "empty.npz", "--cameras", files / "cameras.json")
    assert "a surface of a person's size was found in 1 of the 1 frame" in printed
    assert "it may be furniture, as the background is not known" in printed
    assert "a person was found" not in printed and "1 frame is too few" in printed


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--depth", "depth.npz"], "--depth needs the intrinsics of the camera"),
        (["--cameras", "cameras.json"], "--cameras is for depth images"),
        (["--depth", "depth.npz", "--cameras", "two.json"], "there are 2 cameras, but --depth names 1"),
        (["--depth", "depth.npz", "--cameras", "cameras.json", "--empty", "a.png"], "there are no images"),
        ([], "There is nothing to show"),
    ],
)
def test_what_cannot_be_shown_is_refused(files, capsys, monkeypatch, words, sentence):
    monkeypatch.chdir(files)
    assert sentence in fails(capsys, "view", *words)


def test_intrinsics_are_sufficient_for_a_window(files, monkeypatch):
    """The verb puts the depth images, with a background of empty frames, into the contents of a window."""
    from jaxcap.cli import main
    from jaxcap.cli import view as verb

    camera = {"fx": 138.6, "fy": 138.6, "cx": 79.5, "cy": 59.5, "width": 160, "height": 120}
    (files / "kinect.json").write_text(json.dumps(camera))
    filled = []
    monkeypatch.setattr(verb, "run_window", lambda *words: filled.append(words))
    monkeypatch.setattr(verb, "serve_contents", lambda server, contents, spacing: contents)
    words = ["--depth", "depth.npz", "--cameras", "kinect.json", "--empty", "empty.npz"]
    monkeypatch.chdir(files)
    main(["view", *words])
    contents = filled[0][2](None)
    assert contents.frames == 12 and len(contents.cameras) == 1
    layers = contents.depths[0]
    assert len(layers[0].layers[PERSON_LAYER].points) and not len(layers[11].layers[PERSON_LAYER].points)
