"""glTF as text with files next to it, one clip of several, and files without a skin."""

import base64
import json
import os

import jax.numpy as jnp
import numpy as np
import pygltflib
import pytest
import trimesh
from helpers import chain_body

from jaxcap.body.pose import Motion, Pose
from jaxcap.errors import InputError
from jaxcap.io.gltf.gltf import write_gltf
from jaxcap.io.gltf.gltf_reader import read_gltf, read_gltf_body
from jaxcap.io.registry import (
    default_clip_message,
    is_skinned,
    list_clips,
    read_body,
    read_motion,
    read_skeleton,
    read_skinned,
)
from jaxcap.io.skinned.clip import clip_names, split_clip, suffix_of

JOINTS = chain_body("linear").skeleton.num_joints


def shifts(metres: float, frames: int = 3) -> Motion:
    """The whole body slides along x, so far in each frame."""
    translations = np.zeros((frames, JOINTS, 3))
    translations[:, 0, 0] = metres * np.arange(frames)
    rotations = np.tile([1.0, 0, 0, 0], (frames, JOINTS, 1))
    poses = Pose(jnp.asarray(translations), jnp.asarray(rotations), jnp.ones(frames))
    return Motion(poses, 25.0)


def write_clips(path, names: tuple[str | None, ...] = ("Walk", "Run")) -> None:
    """Write a body with one clip for each name; clip number n slides by n + 1 decimetres a frame."""
    body = chain_body("linear")
    write_gltf(path, body, shifts(0.1))
    document = pygltflib.GLTF2().load(str(path))
    blob, first = bytearray(document.binary_blob()), document.animations[0]
    for number in range(1, len(names)):
        write_gltf(path, body, shifts(0.1 * (number + 1)))
        other = pygltflib.GLTF2().load(str(path))
        start, views, accessors = len(blob), len(document.bufferViews), len(document.accessors)
        blob += other.binary_blob()
        for view in other.bufferViews:
            view.byteOffset = (view.byteOffset or 0) + start
        for accessor in other.accessors:
            accessor.bufferView += views
        for sampler in other.animations[0].samplers:
            sampler.input, sampler.output = sampler.input + accessors, sampler.output + accessors
        document.bufferViews += other.bufferViews
        document.accessors += other.accessors
        document.animations += other.animations
    for animation, name in zip(document.animations, names, strict=True):
        animation.name = name
    assert first is document.animations[0]
    document.buffers = [pygltflib.Buffer(byteLength=len(blob))]
    document.set_binary_blob(bytes(blob))
    document.save_binary(str(path))


def as_text(source, target, uri) -> dict:
    """Write a `.glb` as `.gltf` whose one buffer is at a URI; returns its content."""
    document = pygltflib.GLTF2().load(str(source))
    document.buffers[0].uri = uri
    content = json.loads(document.gltf_to_json())
    target.write_text(json.dumps(content))
    return content


def test_text_with_a_file_or_data_is_the_same_body(tmp_path):
    write_clips(tmp_path / "a.glb")
    body, motion = read_gltf_body(tmp_path / "a.glb")
    blob = pygltflib.GLTF2().load(str(tmp_path / "a.glb")).binary_blob()
    (tmp_path / "sub folder").mkdir()
    (tmp_path / "sub folder" / "a.bin").write_bytes(blob)
    data = "data:application/octet-stream;base64," + base64.b64encode(blob).decode()
    for number, uri in enumerate(("sub%20folder/a.bin", data)):
        path = tmp_path / f"{number}.gltf"
        as_text(tmp_path / "a.glb", path, uri)
        assert is_skinned(path)
        there, moved = read_skinned(path)
        assert there.skeleton.names == body.skeleton.names
        assert there.skeleton.kinds == body.skeleton.kinds
        np.testing.assert_array_equal(there.vertices, body.vertices)
        np.testing.assert_array_equal(there.faces, body.faces)
        np.testing.assert_array_equal(there.skin.bone_weights(JOINTS), body.skin.bone_weights(JOINTS))
        np.testing.assert_array_equal(moved.poses.translations, motion.poses.translations)
        assert read_skeleton(path).names == body.skeleton.names
        assert read_motion(path)[1].num_frames == 3


@pytest.mark.parametrize(
    ("uri", "sentence"),
    [
        ("../secret.bin", "outside of its folder"),
        ("%2e%2e/secret.bin", "outside of its folder"),
        ("/etc/hostname", "outside of its folder"),
        ("file:///etc/hostname", "outside of its folder"),
        ("link.bin", "outside of its folder"),
        ("none.bin", "no such file in its folder"),
        ("pipe", "no such file in its folder"),
        ("data:application/octet-stream;base64,%%%", "URI in it cannot be read"),
        ("data:", "URI in it cannot be read"),
        (None, "buffer 0 is not in this file"),
    ],
)
def test_a_buffer_that_is_elsewhere(tmp_path, uri, sentence):
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(b"\0" * 100000)
    (tmp_path / "in" / "link.bin").symlink_to(tmp_path / "secret.bin")
    os.mkfifo(tmp_path / "in" / "pipe")
    write_clips(tmp_path / "a.glb", ("Walk",))
    as_text(tmp_path / "a.glb", tmp_path / "in" / "a.gltf", uri)
    with pytest.raises(InputError, match=sentence) as error:
        read_skinned(tmp_path / "in" / "a.gltf")
    assert str(tmp_path / "in" / "a.gltf") in str(error.value)


def test_a_buffer_that_is_cut_short(tmp_path):
    write_clips(tmp_path / "a.glb", ("Walk",))
    (tmp_path / "a.bin").write_bytes(pygltflib.GLTF2().load(str(tmp_path / "a.glb")).binary_blob()[:500])
    as_text(tmp_path / "a.glb", tmp_path / "a.gltf", "a.bin")
    with pytest.raises(InputError, match="beyond the end of its buffer"):
        read_skinned(tmp_path / "a.gltf")


def test_one_clip_of_several(tmp_path):
    """Each clip slides at a speed of its own."""
    path = tmp_path / "character.glb"
    write_clips(path, ("Walk", "Armature|Run: fast", None))
    assert list_clips(path) == ("Walk", "Armature|Run: fast", "clip2")
    for number, name in enumerate(list_clips(path)):
        speeds = [
            motion.poses.translations[1, 0, 0]
            for motion in (
                read_motion(f"{path}:{name}")[1],
                read_skinned(f"{path}:{name}")[1],
                read_gltf(path, clip=name)[1],
            )
        ]
        np.testing.assert_allclose(speeds, 0.1 * (number + 1), atol=1e-6)
    assert float(read_motion(path)[1].poses.translations[1, 0, 0]) == pytest.approx(0.1, abs=1e-6)
    for read in (read_motion, read_skinned, read_body, read_skeleton):
        with pytest.raises(
            InputError, match=r"no clip 'Jump'; its clips are Walk, Armature\|Run: fast, clip2\."
        ):
            read(f"{path}:Jump")
    # without a choice it is said which one was taken, and with one nothing is
    said = default_clip_message(path)
    assert said is not None
    assert "3 clips" in said
    assert "'Walk' is read" in said
    assert f"{path}:Armature" in said
    assert default_clip_message(f"{path}:Walk") is None
    write_clips(path, ("Walk",))
    assert default_clip_message(path) is None


def test_names_of_clips(tmp_path):
    assert clip_names(["A", "A", None, "A"]) == ("A", "A_", "clip2", "A__")
    assert split_clip("a.glb:b:c") == (tmp_path.__class__("a.glb"), "b:c")
    assert split_clip("a.npz:b")[1] is None
    assert suffix_of("A.GLTF:Walk") == ".gltf"
    # a file that is called so is that file
    (tmp_path / "a.glb:b").write_bytes(b"")
    assert split_clip(tmp_path / "a.glb:b") == (tmp_path / "a.glb:b", None)


def test_no_skin(tmp_path):
    ball = trimesh.creation.icosphere(1)
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(ball)).items():
        (tmp_path / name.replace("model", "ball")).write_bytes(content)
    (tmp_path / "ball.glb").write_bytes(ball.export(file_type="glb"))
    for suffix in ("glb", "gltf"):
        path = tmp_path / f"ball.{suffix}"
        assert not is_skinned(path)
        for read in (read_body, read_motion, read_skeleton, read_skinned):
            with pytest.raises(InputError, match=f"there is no skin in it.*jaxcap rig .*ball.{suffix}"):
                read(path)
