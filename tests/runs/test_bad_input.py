"""What users get wrong: one sentence on stderr, exit code 2, no traceback, nothing half-written."""

import os
import re
import struct
import tracemalloc

import numpy as np
import pytest
from command_line import fails, tree
from helpers import chain_body

from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.skeleton import make_skeleton
from jaxcap.errors import InputError
from jaxcap.io.archives.npz import save_body, save_motion
from jaxcap.io.gltf.gltf_document import read_gltf_json
from jaxcap.io.skeletons.bvh import read_bvh, write_bvh
from jaxcap.io.system.run_lock import run_lock
from jaxcap.observe.clouds import make_cloud
from jaxcap.tracking.check_cloud import check_cloud, check_cloud_extent

SKL = """KBSKEL 3
hips TRANSLATE NULL
spine BALL hips
elbow REVOLUTE spine
hips 0 0 0
spine 0 0.3 0
elbow 1 0 0 0 0.6 0
"""


@pytest.fixture
def inputs(tmp_path):
    """A body as `.npz`, the same sort as a mesh with `.skl`, `.vj` and `.cst`, and clouds."""
    folder = tmp_path / "inputs"
    folder.mkdir()
    body = chain_body()
    save_body(folder / "body.npz", body)
    points = np.asarray(body.vertices)
    normals = points - points.mean(0)
    np.savez(folder / "clouds.npz", points=np.stack([points] * 3), normals=np.stack([normals] * 3))
    # a closed box of 0.2 x 0.8 x 0.2 m
    vertices = np.array([[x, y, z] for x in (0, 0.2) for y in (0, 0.8) for z in (0, 0.2)])
    faces = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]]
    faces += [[0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
    write_off(folder / "box.off", vertices, faces)
    (folder / "box.skl").write_text(SKL)
    (folder / "box.vj").write_text("hips\nhips\nspine\nelbow\nhips\nhips\nspine\nelbow\n")
    (folder / "box.cst").write_text("KBCST 1\nelbow -0.1 2.4\n")
    for number in range(4):
        write_off(folder / f"scan_{number:03d}.off", vertices[[0] * 12] + 0.1 * np.eye(3)[[0, 1, 2] * 4], [])
    return folder


def write_off(path, vertices, faces) -> None:
    rows = [f"OFF\n{len(vertices)} {len(faces)} 0"]
    rows += [" ".join(f"{x:g}" for x in vertex) for vertex in vertices]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(rows) + "\n")


def refused(capsys, inputs, body, clouds, *more) -> str:
    """The sentence with which tracking is refused, before anything is written."""
    before = tree(inputs.parent)
    out = inputs.parent / "out"
    line = fails(capsys, "track", inputs / body, inputs / clouds, "-o", out, *more)
    assert tree(inputs.parent) == before
    assert not out.exists()
    return line


def change_clouds(inputs, change) -> None:
    with np.load(inputs / "clouds.npz") as file:
        points = file["points"]
    np.savez(inputs / "clouds.npz", points=change(points))


def test_one_run_at_a_time(inputs, tmp_path, capsys):
    """A second run in a folder is told whose it is, and changes nothing there; the first's end frees it."""
    out = tmp_path / "out"
    out.mkdir()
    with run_lock(out):
        before = tree(out)
        for command in (
            ("track", inputs / "body.npz", inputs / "clouds.npz", "-o", out, "--overwrite"),
            ("demo", "-o", out),
        ):
            assert f"out: another run (process {os.getpid()}) writes to this output" in fails(
                capsys, *command
            )
        assert tree(out) == before
    with run_lock(out / "body.npz"):
        command = ("learn", inputs / "clouds.npz", "-o", out / "body.npz")
        assert "body.npz: another run (process" in fails(capsys, *command)
    assert tree(out) == {}


def test_empty_cloud(inputs, capsys):
    change_clouds(inputs, lambda points: points[:, :0])
    assert "clouds.npz[0]" in refused(capsys, inputs, "body.npz", "clouds.npz")


def test_empty_cloud_file(inputs, capsys):
    (inputs / "scan_000.off").write_text("OFF\n0 0 0\n")
    assert "scan_000.off" in refused(capsys, inputs, "body.npz", "scan_%03d.off")


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_coordinates_that_are_not_finite(inputs, capsys, number):
    def spoil(points):
        points[0, 7, 1] = number
        return points

    change_clouds(inputs, spoil)
    line = refused(capsys, inputs, "body.npz", "clouds.npz")
    assert "clouds.npz[0]" in line
    assert "point 7" in line


def test_coordinates_that_are_not_finite_in_text(inputs, capsys):
    text = (inputs / "scan_000.off").read_text().splitlines()
    text[4] = "0.1 nan 0.2"
    (inputs / "scan_000.off").write_text("\n".join(text))
    line = refused(capsys, inputs, "body.npz", "scan_%03d.off")
    assert "scan_000.off" in line
    assert "point 2" in line


def test_fewer_points_than_parameters(inputs, capsys):
    change_clouds(inputs, lambda points: points[:, :20])
    line = refused(capsys, inputs, "body.npz", "clouds.npz")
    assert "20 points" in line
    assert f"{chain_body().skeleton.num_dofs} parameters" in line


@pytest.mark.parametrize(("factor", "unit"), [(1000.0, "(mm)"), (100.0, "(cm)"), (39.37, "(in)")])
def test_other_units_given_as_metres(inputs, capsys, factor, unit):
    change_clouds(inputs, lambda points: factor * points)
    assert unit in refused(capsys, inputs, "body.npz", "clouds.npz")


def test_mesh_in_millimetres_given_as_metres(inputs, capsys):
    text = (inputs / "box.off").read_text().replace("0.2", "200").replace("0.8", "800")
    (inputs / "box.off").write_text(text)
    line = refused(capsys, inputs, "box.off", "scan_%03d.off")
    assert "box.off" in line
    assert "millimetres" in line


def test_mesh_with_an_unused_vertex(inputs, capsys):
    text = (
        (inputs / "box.off")
        .read_text()
        .replace("8 12 0", "9 12 0")
        .replace("0.2 0.8 0.2\n", "0.2 0.8 0.2\n1 1 1\n")
    )
    (inputs / "box.off").write_text(text)
    assert "vertex 8" in refused(capsys, inputs, "box.off", "scan_%03d.off")


def test_mesh_with_a_degenerate_face(inputs, capsys):
    text = (inputs / "box.off").read_text().replace("3 0 3 2", "3 0 3 3")
    (inputs / "box.off").write_text(text)
    assert "face 1" in refused(capsys, inputs, "box.off", "scan_%03d.off")


def test_rigging_a_mesh_that_is_none(inputs, capsys):
    lines = (inputs / "box.off").read_text().splitlines()
    flat = [f"{line} 3 0 3 3"[-7:] if line.startswith("3 ") else line for line in lines]
    (inputs / "box.off").write_text("\n".join(flat) + "\n")
    before = tree(inputs)
    assert "no faces" in fails(capsys, "rig", inputs / "box.off", "-o", inputs / "rigged.npz")
    assert tree(inputs) == before


@pytest.mark.parametrize("lines", [7, 9])
def test_vj_of_another_length(inputs, capsys, lines):
    (inputs / "box.vj").write_text("hips\n" * lines)
    line = refused(capsys, inputs, "box.off", "scan_%03d.off")
    assert f"box.vj:{lines}" in line
    assert "8 vertices" in line


def test_vj_with_an_unknown_joint(inputs, capsys):
    (inputs / "box.vj").write_text("hips\nhips\nknee\n" + "hips\n" * 5)
    line = refused(capsys, inputs, "box.off", "scan_%03d.off")
    assert "box.vj:3" in line
    assert "knee" in line


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("hips TRANSLATE NULL", "hips TRANSLATE elbow", ("descends from itself", "box.skl:2")),
        ("spine BALL hips", "spine BALL pelvis", ("pelvis", "box.skl:3")),
        ("spine 0 0.3 0\n", "", ("spine", "no coordinates")),
        ("0 0.6 0\n", "0 0.6\n", ("elbow", "box.skl:7")),
    ],
)
def test_skl_that_is_wrong(inputs, capsys, old, new, words):
    (inputs / "box.skl").write_text(SKL.replace(old, new))
    line = refused(capsys, inputs, "box.off", "scan_%03d.off")
    for word in words:
        assert word in line


def test_cst_with_the_smallest_above_the_largest(inputs, capsys):
    (inputs / "box.cst").write_text("KBCST 1\nelbow 2.4 -0.1\n")
    line = refused(capsys, inputs, "box.off", "scan_%03d.off", "--limits", inputs / "box.cst")
    assert "box.cst:2" in line
    assert "elbow" in line


def test_frame_missing_in_a_sequence(inputs, capsys):
    (inputs / "scan_002.off").unlink()
    for clouds in ("scan_%03d.off", "scan_*.off"):
        line = refused(capsys, inputs, "body.npz", clouds)
        assert "2" in line.replace("scan_002", "2")
        assert "missing" in line


def test_no_clouds_at_all(inputs, capsys):
    assert "frame_%03d.off" in refused(capsys, inputs, "body.npz", "frame_%03d.off")
    assert "no such file" in refused(capsys, inputs, "body.npz", "nowhere")


def test_output_folder_that_cannot_be(inputs, capsys):
    (inputs.parent / "file").write_text("here")
    before = tree(inputs.parent)
    line = fails(
        capsys, "track", inputs / "body.npz", inputs / "clouds.npz", "-o", inputs.parent / "file" / "out"
    )
    assert "cannot be written" in line
    line = fails(capsys, "track", inputs / "body.npz", inputs / "clouds.npz", "-o", inputs.parent / "file")
    assert "cannot be written" in line
    assert tree(inputs.parent) == before


def test_truncated_bvh(inputs, capsys):
    skeleton = make_skeleton(["hips", "spine"], [-1, 0], ["free", "ball"], [[0, 0, 0], [0, 0.5, 0]])
    path = inputs / "short.bvh"
    write_bvh(path, skeleton, stack_poses([rest_pose(skeleton)] * 4))
    lines = path.read_text().splitlines()
    before = tree(inputs)
    for kept in (len(lines) - 1, len(lines) - 5, 4):
        path.write_text("\n".join(lines[:kept]) + "\n")
        assert "short.bvh" in fails(capsys, "info", path)
        assert "short.bvh" in fails(capsys, "convert", path, inputs / "motion.npz")
        assert "short.bvh" in fails(capsys, "evaluate", inputs / "body.npz", path, inputs / "clouds.npz")
    assert set(tree(inputs)) == set(before)


def test_body_that_is_none(inputs, capsys):
    assert "no such file" in refused(capsys, inputs, "nobody.npz", "clouds.npz")
    assert "clouds.npz" in refused(capsys, inputs, "clouds.npz", "clouds.npz")
    (inputs / "box.skl").unlink()
    assert "box.skl" in refused(capsys, inputs, "box.off", "scan_%03d.off")


def test_human_that_is_none(inputs, tmp_path, capsys):
    for spec, word in (("human:tall", "tall"), ("human:height=9", "9"), ("human:age=old", "old")):
        assert word in fails(capsys, "track", spec, inputs / "clouds.npz", "-o", tmp_path / "out")


def test_pickled_arrays_are_never_read(inputs, capsys):
    np.savez(inputs / "clouds.npz", points=np.array([{"a": 1}], dtype=object))
    assert "pickled" in refused(capsys, inputs, "body.npz", "clouds.npz")


def test_motion_of_another_length(inputs, capsys):
    body = chain_body()
    save_motion(inputs / "motion.npz", stack_poses([rest_pose(body.skeleton)] * 2), body.skeleton)
    line = fails(capsys, "evaluate", inputs / "body.npz", inputs / "motion.npz", inputs / "clouds.npz")
    assert "2 frames" in line
    assert "3 clouds" in line


def test_cloud_of_a_body_is_fine():
    """What the checks let pass: the body's own points, a half of them, and a few far outliers."""
    body = chain_body()
    points = np.asarray(body.vertices)
    for cloud in (points, points[:24], np.concatenate([points, [[50.0, 0, 0]]])):
        check_cloud(body, make_cloud(cloud, cloud))


@pytest.mark.parametrize(
    ("share", "factor", "likely"),
    [
        (1.0, 1000, "it looks like millimetres (mm): give"),
        (1.0, 100, "it looks like centimetres (cm): give"),
        (0.7, 100, "it looks like centimetres (cm): give"),
        (1.0, 10, "it looks like decimetres (dm): give"),
        # of a person who is not seen whole
        (0.4, 100, "it looks like centimetres (cm) or inches (in): give"),
        (0.6, 39.37, "it looks like inches (in): give"),
        (1.0, 1e6, "check the units of both."),
    ],
)
def test_units_that_a_scan_may_be_in_are_named(share, factor, likely):
    body = chain_body()
    height = np.ptp(np.asarray(body.vertices), axis=0).max()
    seen = np.linspace([0.0, 0.0, 0.1], [0.1, share * height, 0.1], 200)
    with pytest.raises(InputError, match=re.escape(likely)):
        check_cloud_extent(body, factor * seen, "the cloud")


def test_a_line_of_very_many_words_takes_little_memory(tmp_path):
    """Each word is kept with its place in the line, and not with the rest of the line."""
    path = tmp_path / "long.bvh"
    channels = " ".join(["Xposition"] * 20_000)
    path.write_text(f"HIERARCHY\nROOT a\n{{\nOFFSET 0 0 0\nCHANNELS 6 {channels}\n}}\nMOTION\n")
    tracemalloc.start()
    with pytest.raises(InputError, match="occurs twice"):
        read_bvh(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 100e6


def test_a_head_that_promises_more_than_is_there(tmp_path):
    path = tmp_path / "body.glb"
    path.write_bytes(struct.pack("<4s4I", b"glTF", 2, 20, 2**32 - 1, 0x4E4F534A) + b"{}")
    tracemalloc.start()
    assert read_gltf_json(path) == {}
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1e6
