"""`jaxcap ik` as a user types it, without a window; and what is refused."""

import json
import socket

import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs

import jaxcap as jc
from jaxcap.cli import main

HEAD = '{"format": "jaxcap constraints", "version": 1, "constraints": '


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A knee that bends, and constraints that it can and cannot meet."""
    folder = tmp_path_factory.mktemp("ik")
    axes = [[[1.0, 0, 0], [0, 0, 1]], [[1.0, 0, 0], [0, 1, 0]]]
    skeleton = jc.make_skeleton(
        ("hip", "knee"), (-1, 0), ("universal", "revolute"), [[0.0, 1, 0], [0.0, 0.5, 0]], axes=axes
    )
    sole = jnp.array([[0.0, 0, 0], [0, 0, 0.1], [0.05, 0, 0]])
    body = jc.Body(skeleton, jc.body.RigidSkin(jnp.array([1, 1, 1])), sole, jnp.array([[0, 1, 2]]))
    jc.save_body(folder / "leg.npz", body)
    (folder / "near.json").write_text(HEAD + '[{"vertex": 0, "target": [0, 0.3, 0.3]}]}')
    (folder / "far.json").write_text(
        HEAD + '[{"vertex": 0, "target": [0, 0, 3]}, {"joint": "hip", "target": [0, 1, 0]}]}'
    )
    return folder


def test_constraints_are_met_and_the_pose_is_written(folder, capsys):
    told = runs(
        capsys, "ik", folder / "leg.npz", "--constraints", folder / "near.json", "-o", folder / "pose.npz"
    )
    assert "vertex 0" in told and "written" in told
    body = jc.load_body(folder / "leg.npz")
    pose = jc.load_motion(folder / "pose.npz", body.skeleton)[0]
    assert np.linalg.norm(jc.pose_body(body, pose).vertices[0] - np.array([0, 0.3, 0.3])) < 1e-3
    # goes on from there; a target out of reach is told, and the pose written all the same
    runs(capsys, "ik", folder / "leg.npz", "--pose", folder / "pose.npz", "--constraints", folder / "far.json", "-o",
         folder / "far.bvh")  # fmt: skip
    assert jc.read_bvh(folder / "far.bvh")[1].num_frames == 1
    (folder / "mm.json").write_text(HEAD + '[{"vertex": 0, "target": [0, 300, 300]}]}')
    main(
        [
            "ik",
            str(folder / "leg.npz"),
            "--constraints",
            str(folder / "mm.json"),
            "-o",
            str(folder / "mm.npz"),
        ]
    )
    assert "a target is 424 m from the body; targets are in metres" in capsys.readouterr().err


def test_limits_are_kept(folder, capsys):
    (folder / "leg.cst").write_text("KBCST 1\nknee 0 0.5\n")
    (folder / "behind.json").write_text(HEAD + '[{"vertex": 0, "target": [0, 0.3, -0.3]}]}')
    runs(capsys, "ik", folder / "leg.npz", "--limits", folder / "leg.cst", "--constraints", folder / "behind.json", "-o",
         folder / "kept.npz")  # fmt: skip
    body = jc.load_body(folder / "leg.npz")
    pose = jc.load_motion(folder / "kept.npz", body.skeleton)[0]
    bend = 2 * np.arctan2(pose.rotations[1, 1], pose.rotations[1, 0])
    assert 0.49 < bend <= 0.5 + 1e-6


def test_what_is_wrong_is_told_in_a_sentence(folder, capsys):
    leg, near, out = folder / "leg.npz", folder / "near.json", folder / "out.npz"
    (folder / "other.json").write_text(json.dumps({"format": "jaxcap constraints", "version": 1, "constraints": [
        {"vertex": 77, "target": [0, 0, 0]}]}))  # fmt: skip
    (folder / "there.npz").write_bytes(b"")
    (folder / "empty.npz").mkdir()
    skeleton = jc.load_body(leg).skeleton
    jc.save_motion(
        folder / "still.npz", jc.stack_poses([jc.rest_pose(skeleton)]).slice(slice(0, 0)), skeleton
    )
    wrong = [
        ([leg, "--constraints", near, "-o", folder / "none" / "out.npz"], "its folder does not exist"),
        ([leg, "--constraints", near, "-o", folder / "empty.npz"], "empty.npz: this is a folder"),
        (
            [leg, "--constraints", near, "-o", out, "--pose", folder / "still.npz"],
            "this motion has no frames",
        ),
        (["nowhere.obj"], "nowhere.obj: there is no such file"),
        ([leg, "--frame", "2"], "--frame 2 selects a frame of a motion"),
        ([leg, "-o", out], "there are no constraints;"),
        ([leg, "--constraints", near, "-o", folder / "out.fbx"], "poses are not written as '.fbx' files"),
        ([leg, "--constraints", near, "-o", folder / "there.npz"], "already exists; give --overwrite"),
        ([leg, "--constraints", folder / "none.json", "-o", out], "none.json: there is no such file"),
        (
            [leg, "--constraints", folder / "other.json", "-o", out],
            "vertex 77, but the body has vertices 0 to 2",
        ),
        ([leg, "--pose", near, "--constraints", near, "-o", out], "near.json"),
        ([leg, "--prior", leg, "--constraints", near, "-o", out], "the file contains no pose prior"),
        ([leg, "--limits", leg, "--constraints", near, "-o", out], "leg.npz"),
    ]
    for arguments, sentence in wrong:
        assert sentence in fails(capsys, "ik", *arguments), arguments
    assert not out.exists()
    poses = jc.stack_poses([jc.rest_pose(jc.load_body(leg).skeleton)] * 2)
    jc.save_motion(folder / "two.npz", poses, jc.load_body(leg).skeleton)
    sentence = fails(
        capsys, "ik", leg, "--pose", folder / "two.npz", "--frame", "2", "--constraints", near, "-o", out
    )
    assert "there is no frame 2 in this motion; its frames are 0 to 1" in sentence


def test_a_port_that_is_taken_is_told(folder, capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen(1)
        port = other.getsockname()[1]
        sentence = fails(capsys, "ik", folder / "leg.npz", "--no-browser", "--port", port)
    assert f"port {port}: another program uses this port" in sentence
