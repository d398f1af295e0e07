"""What `jaxcap info` says, and that a body is one everywhere."""

import re

import numpy as np
import pytest
from command_line import fails, runs
from helpers import chain_body

from jaxcap.body.pose import rest_pose, stack_poses
from jaxcap.body.skin import RigidSkin
from jaxcap.io.kinds import KIND_NAMES, KIND_PLURALS, identify, kind_of_arrays
from jaxcap.io.meshes.mesh import Mesh, write_mesh
from jaxcap.io.registry import read_body, read_skeleton, read_skinned
from jaxcap.io.skeletons.bvh import write_bvh
from jaxcap.io.skeletons.skl import write_skl
from jaxcap.io.skeletons.vj import write_vj


@pytest.fixture
def doll(tmp_path):
    """A mesh, its skeleton and its parts in a folder of their own, and the body that they are."""
    body = chain_body("rigid")
    folder = tmp_path / "doll"
    folder.mkdir()
    write_mesh(folder / "me.obj", Mesh(np.asarray(body.vertices), np.asarray(body.faces)))
    write_skl(folder / "me.skl", body.skeleton)
    write_vj(folder / "me.vj", body.skeleton, np.asarray(body.skin.bones))
    return folder / "me.obj", body


def deep_bvh(joints: int) -> str:
    tree = "".join(f"JOINT j{i}\n{{\nOFFSET 0 1 0\nCHANNELS 0\n" for i in range(joints))
    return (
        f"HIERARCHY\nROOT j\n{{\nOFFSET 0 0 0\nCHANNELS 0\n{tree}{'}' * 1}"
        + "\n}" * joints
        + "\nMOTION\nFrames: 1\nFrame Time: 0.01\n\n"
    )


def test_a_deep_tree_is_told_in_few_lines(tmp_path, capsys):
    (tmp_path / "deep.bvh").write_text(deep_bvh(3000))
    said = runs(capsys, "info", tmp_path / "deep.bvh")
    assert len(said) < 30_000
    lines = said.splitlines()
    assert len(lines) < 220
    assert "skeleton: 3001 joints" in said
    assert re.search(r"\.\.\. and 2801 more joints", said)
    assert lines[-1].startswith("next: ")


def test_a_tree_that_fits_is_told_whole(doll, capsys):
    said = runs(capsys, "info", doll[0].with_suffix(".skl"))
    assert all(f" {name} (" in said for name in doll[1].skeleton.names)
    assert "more joints" not in said


def test_a_mesh_with_its_bones_is_a_body_everywhere(doll, capsys, tmp_path):
    path, body = doll
    assert identify(path) == "rigged"
    assert read_skeleton(path).names == body.skeleton.names
    assert isinstance(read_body(path).skin, RigidSkin)
    told = runs(capsys, "info", path)
    assert told.startswith(f"body: {len(body.vertices)} vertices") and "RigidSkin" in told
    assert f"`jaxcap track {path} CLOUDS" in told and "rig " not in told
    runs(capsys, "convert", path, tmp_path / "me.glb")
    skinned, _ = read_skinned(tmp_path / "me.glb")
    assert skinned.skeleton.num_joints == body.skeleton.num_joints
    np.testing.assert_allclose(np.sort(skinned.vertices, 0), np.sort(body.vertices, 0), atol=1e-5)
    # another mesh it becomes as before
    runs(capsys, "convert", path, tmp_path / "me.ply")
    assert runs(capsys, "info", tmp_path / "me.ply").startswith("mesh: ")


def test_a_folder_of_such_a_mesh_holds_a_body(doll, capsys):
    told = runs(capsys, "info", doll[0].parent)
    assert told.splitlines()[0] == "a mesh with its skeleton (.skl) and parts (.vj)"
    assert f"`jaxcap info {doll[0]}`" in told and "human" not in told and "cloud" not in told


def test_a_mesh_without_one_of_its_files_is_none(doll, capsys):
    path, _ = doll
    path.with_suffix(".vj").unlink()
    told = runs(capsys, "info", path)
    assert told.startswith("mesh: ") and f"`jaxcap rig {path}" in told


def test_files_of_a_folder_are_counted_in_english(tmp_path, capsys):
    body = chain_body("linear")
    motion = stack_poses([rest_pose(body.skeleton)], rate=30.0)
    for number in range(3):
        write_bvh(tmp_path / f"{number}.bvh", body.skeleton, motion)
    write_skl(tmp_path / "one.skl", body.skeleton)
    told = runs(capsys, "info", tmp_path).splitlines()
    assert told[:2] == ["3 motions with their skeletons (BVH)", "a Kineben skeleton (.skl)"]
    assert runs(capsys, "info", tmp_path / "0.bvh").startswith("motion: 1 frame at 30 frames per second")
    assert set(KIND_PLURALS) == set(KIND_NAMES)


@pytest.mark.parametrize(
    "arrays",
    [
        {"points": np.array([["a"]]), "offsets": np.array([0, 1])},
        {"vertices": np.array([["a"]]), "faces": np.array([[0, 1, 2]])},
        {"vertices": np.zeros((1, 3, 3)), "faces": np.array([[0.0, 1, 2]])},
        {"vertices": np.zeros((1, 3, 3)), "faces": np.array([[0, 1, 2]]), "skin": np.zeros(3)},
        {"points": np.zeros((1, 3, 3)), "skin": np.zeros(3)},
    ],
)
def test_info_does_not_send_to_itself(tmp_path, capsys, arrays):
    np.savez(tmp_path / "a.npz", **arrays)
    if "skin" in arrays:
        assert "no verb reads these arrays" in runs(capsys, "info", tmp_path / "a.npz")
    else:
        assert "jaxcap info" not in fails(capsys, "info", tmp_path / "a.npz")


def test_the_unit_of_a_scan_is_guessed_from_its_size(doll, capsys, tmp_path):
    box = np.array([[0, 0, 0], [40.0, 0, 0], [0, 172.0, 0], [0, 0, 25.0]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]])
    for name, mesh in (("mesh.ply", Mesh(box, faces)), ("cloud.ply", Mesh(box, np.zeros((0, 3), int)))):
        write_mesh(tmp_path / name, mesh)
        said = runs(capsys, "info", tmp_path / name)
        assert "172 m; in cm it would have the size of a person" in said
        assert all(command.endswith("--unit cm") for command in re.findall(r"`(jaxcap [^`]*)`", said))
        # the commands repeat a unit that was given
        said = runs(capsys, "info", tmp_path / name, "--unit", "cm")
        assert "would have" not in said and "--unit cm`" in said
    # a person in a room of six metres is likelier than a person in feet
    write_mesh(tmp_path / "room.ply", Mesh(box * 6 / 172, np.zeros((0, 3), int)))
    said = runs(capsys, "info", tmp_path / "room.ply")
    assert "unless more than a person is in it" in said and "--unit" not in said


def test_a_face_without_area_does_not_make_a_mesh_unusable(doll, capsys, tmp_path):
    path, body = doll
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    # as marching cubes leave them: a face of two vertices at one place, and a vertex that no face uses
    vertices = np.concatenate([vertices, vertices[faces[0, :1]], [[0.0, 0.0, 0.0]]])
    flat = [[faces[0, 0], len(vertices) - 2, faces[0, 1]]]
    write_mesh(tmp_path / "scan.obj", Mesh(vertices, np.concatenate([faces, flat])))
    assert "`jaxcap rig " in runs(capsys, "info", tmp_path / "scan.obj")
    words = ("rig", tmp_path / "scan.obj", "--skeleton", path.with_suffix(".skl"), "--method", "envelopes")
    said = runs(capsys, *words, "-o", tmp_path / "rigged.npz")
    assert "left out: 1 face without area and 2 vertices that no other face uses" in said
    rigged = read_body(tmp_path / "rigged.npz")
    np.testing.assert_array_equal(rigged.faces, body.faces)
    np.testing.assert_allclose(rigged.vertices, body.vertices, atol=1e-6)


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        ({"depth", "poses", "fps"}, "depth"),
        ({"points", "poses", "fps"}, "clouds"),
        ({"vertices", "faces", "poses", "fps"}, "meshes"),
        ({"vertices", "faces", "poses", "trans"}, "amass"),
        ({"vertices", "faces", "global_orient", "body_pose", "transl"}, "amass"),
    ],
)
def test_the_poses_of_cameras_are_not_those_of_people(names, kind):
    assert kind_of_arrays(names) == kind
