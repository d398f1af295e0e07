"""What other programs see in a `.glb`: pygltflib reads it, and the skinning of the glTF
specification is evaluated here in plain NumPy, node by node and vertex by vertex."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pygltflib
import pytest
import trimesh
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import Body, pose_body
from jaxcap.body.people.human import human
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.pose import Motion, stack_poses
from jaxcap.edit.linear_blend.influences import limit_influences
from jaxcap.errors import InputError
from jaxcap.io.gltf.gltf import write_gltf
from jaxcap.io.gltf.gltf_reader import read_gltf, read_gltf_body

_pose_body = eqx.filter_jit(pose_body)
NUMBERS = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Viewer:
    """A slow reader of glTF 2.0: accessors, node transforms, animation, skinning."""

    def __init__(self, path):
        self.file = pygltflib.GLTF2().load(str(path))
        self.blob = self.file.binary_blob()
        self.animation = self.file.animations[0] if self.file.animations else None

    def array(self, index: int) -> np.ndarray:
        accessor = self.file.accessors[index]
        view = self.file.bufferViews[accessor.bufferView]
        width = WIDTHS[accessor.type]
        start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
        flat = np.frombuffer(self.blob, NUMBERS[accessor.componentType], accessor.count * width, start)
        return flat.reshape(accessor.count, width) if width > 1 else flat

    def pose(self, time: float) -> list[dict[str, np.ndarray]]:
        """Translation, rotation (xyzw) and scale of every node at a time, seconds."""
        rest = {"translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]}
        nodes = [
            {key: np.array(getattr(node, key) or plain, float) for key, plain in rest.items()}
            for node in self.file.nodes
        ]
        for channel in self.animation.channels if self.animation else []:
            sampler = self.animation.samplers[channel.sampler]
            times, values = self.array(sampler.input), self.array(sampler.output).astype(float)
            if channel.target.path == "weights":
                # section 3.11: all targets of a key follow each other
                values = values.reshape(len(times), -1)
            before = int(np.clip(np.searchsorted(times, time, "right") - 1, 0, max(len(times) - 2, 0)))
            after = min(before + 1, len(times) - 1)
            gap = times[after] - times[before]
            share = float(np.clip((time - times[before]) / gap, 0, 1)) if gap else 0.0
            start, end = values[before], values[after]
            if channel.target.path == "rotation":
                start, end = Rotation.from_quat(start), Rotation.from_quat(end)
                value = (start * Rotation.from_rotvec(share * (start.inv() * end).as_rotvec())).as_quat()
            else:
                value = (1 - share) * start + share * end
            nodes[channel.target.node][channel.target.path] = value
        return nodes

    def vertices(self, time: float) -> np.ndarray:
        nodes, world = self.pose(time), {}
        stack = [(root, np.eye(4)) for root in self.file.scenes[self.file.scene].nodes]
        while stack:
            node, above = stack.pop()
            local = np.eye(4)
            local[:3, :3] = Rotation.from_quat(nodes[node]["rotation"]).as_matrix() * nodes[node]["scale"]
            local[:3, 3] = nodes[node]["translation"]
            world[node] = above @ local
            stack += [(child, world[node]) for child in self.file.nodes[node].children or []]
        (skinned,) = [node for node in self.file.nodes if node.mesh is not None]
        skin, primitive = self.file.skins[skinned.skin], self.file.meshes[skinned.mesh].primitives[0]
        inverse = self.array(skin.inverseBindMatrices).astype(float).reshape(-1, 4, 4).transpose(0, 2, 1)
        moves = np.array([world[joint] @ inverse[i] for i, joint in enumerate(skin.joints)])
        rest = self.array(primitive.attributes.POSITION).astype(float)
        weights = nodes[self.file.nodes.index(skinned)].get("weights", self.file.meshes[skinned.mesh].weights)
        for target, weight in zip(primitive.targets or [], () if weights is None else weights, strict=True):
            rest += weight * self.array(target["POSITION"] if isinstance(target, dict) else target.POSITION)
        total, posed = np.zeros(len(rest)), np.zeros_like(rest)
        for i in range(16):
            if getattr(primitive.attributes, f"JOINTS_{i}", None) is None:
                break
            joints = self.array(getattr(primitive.attributes, f"JOINTS_{i}"))
            weights = self.array(getattr(primitive.attributes, f"WEIGHTS_{i}")).astype(float)
            for joint, weight in zip(joints.T, weights.T, strict=True):
                carried = np.einsum("vab,vb->va", moves[joint], np.c_[rest, np.ones(len(rest))])
                posed += weight[:, None] * carried[:, :3]
                total += weight
        np.testing.assert_allclose(total, 1.0, atol=1e-6)
        return posed


def check_against_pose_body(path, body: Body, motion: Motion, frames) -> None:
    viewer = Viewer(path)
    for frame in frames:
        seen = viewer.vertices(frame / motion.rate)
        np.testing.assert_allclose(seen, _pose_body(body, motion[frame]).vertices, rtol=0, atol=1e-5)


@pytest.mark.parametrize("skin", ["rigid", "linear"])
def test_gltf_skinning_is_that_of_pose_body(tmp_path, rng, skin):
    """Every kind of joint, frames of the joints askew, a fork, and a scale that changes."""
    body = chain_body(skin)
    tilted = Rotation.random(body.skeleton.num_joints, random_state=3).as_quat(scalar_first=True)
    body = eqx.tree_at(lambda b: b.skeleton.orientations, body, jnp.asarray(tilted))
    motion = stack_poses(
        [random_pose(body.skeleton, rng, 0.8, scale) for scale in (1.0, 1.2, 0.9)], rate=25.0
    )
    write_gltf(tmp_path / "chain.glb", body, motion)
    check_against_pose_body(tmp_path / "chain.glb", body, motion, range(3))
    write_gltf(tmp_path / "still.glb", body)
    still = Viewer(tmp_path / "still.glb")
    assert still.animation is None
    np.testing.assert_allclose(still.vertices(0.0), body.vertices, rtol=0, atol=1e-6)


def test_a_human_walks(tmp_path):
    body = human(resolution="low")
    motion = walk_and_wave(body.skeleton, seconds=1.0)
    write_gltf(tmp_path / "human.glb", body, motion)
    check_against_pose_body(tmp_path / "human.glb", body, motion, (0, 11, 29))
    viewer = Viewer(tmp_path / "human.glb")
    assert [node.name for node in viewer.file.nodes[:31]] == list(body.skeleton.names)
    # what does not move has no channel, and the clock runs at the motion's rate
    moved = {viewer.file.nodes[channel.target.node].name for channel in viewer.animation.channels}
    assert "RightForeArm" in moved
    assert "LHipJoint" not in moved
    times = viewer.array(viewer.animation.samplers[0].input)
    np.testing.assert_allclose(times, np.arange(30) / 30.0, atol=1e-6)
    # between two frames a joint is half-way, whatever the signs of the quaternions
    joint = body.skeleton.index("RightForeArm")
    before, between, after = (
        Rotation.from_quat(viewer.pose((20 + share) / 30)[joint]["rotation"]) for share in (0, 0.5, 1)
    )
    assert (before.inv() * between).magnitude() == pytest.approx((between.inv() * after).magnitude())
    scene = trimesh.load(tmp_path / "human.glb", process=False)
    (surface,) = scene.dump() if isinstance(scene, trimesh.Scene) else [scene]
    np.testing.assert_allclose(surface.vertices, body.vertices, atol=1e-6)
    np.testing.assert_array_equal(surface.faces, body.faces)
    assert surface.volume > 0.05


def test_four_influences_for_programs_that_read_no_more(tmp_path):
    body = human(resolution="low")
    few = limit_influences(body)
    write_gltf(tmp_path / "few.glb", few, walk_and_wave(few.skeleton, seconds=0.2))
    attributes = Viewer(tmp_path / "few.glb").file.meshes[0].primitives[0].attributes
    assert getattr(attributes, "JOINTS_1", None) is None
    check_against_pose_body(tmp_path / "few.glb", few, walk_and_wave(few.skeleton, seconds=0.2), (5,))
    kept, all_of_it = np.asarray(few.skin.bone_weights(31)), np.asarray(body.skin.bone_weights(31))
    ratio = kept[kept > 0] / all_of_it[kept > 0]
    assert ratio.min() >= 1 - 1e-12
    assert ((kept > 0).sum(1) == np.minimum((all_of_it > 0).sum(1), 4)).all()
    # at rest all bones agree
    np.testing.assert_allclose(Viewer(tmp_path / "few.glb").vertices(0.0), body.vertices, atol=1e-5)


def test_what_cannot_be_written_is_said(tmp_path, rng):
    body = chain_body("linear")
    motion = stack_poses([random_pose(body.skeleton, rng)])
    broken = eqx.tree_at(lambda m: m.poses.rotations, motion, motion.poses.rotations.at[0, 2].set(jnp.nan))
    for name, given, sentence in (
        ("body.fbx", motion, "use .glb"),
        ("body.glb", stack_poses([random_pose(human(resolution="low").skeleton, rng)]), "31 joints"),
        ("body.glb", motion.slice(slice(0, 0)), "no frames"),
        ("body.glb", broken, "frame 0"),
    ):
        with pytest.raises(InputError, match=sentence):
            write_gltf(tmp_path / name, body, given)
    assert not list(tmp_path.iterdir())


def test_skeleton_and_motion_come_back(tmp_path, rng):
    """What `write_gltf` wrote, at the precision of the file; the poses by where they take the joints."""
    body = chain_body("linear")
    tilted = Rotation.random(body.skeleton.num_joints, random_state=3).as_quat(scalar_first=True)
    body = eqx.tree_at(lambda b: b.skeleton.orientations, body, jnp.asarray(tilted))
    motion = stack_poses(
        [random_pose(body.skeleton, rng, 0.8, scale) for scale in (1.0, 1.2, 0.9)], rate=25.0
    )
    write_gltf(tmp_path / "chain.glb", body, motion)
    skeleton, back = read_gltf(tmp_path / "chain.glb")
    assert (skeleton.names, skeleton.parents, skeleton.kinds) == (
        body.skeleton.names, body.skeleton.parents, body.skeleton.kinds,
    )  # fmt: skip
    np.testing.assert_allclose(skeleton.centres, body.skeleton.centres, atol=1e-6)
    turned = Rotation.from_quat(np.array(skeleton.orientations), scalar_first=True)
    np.testing.assert_allclose(skeleton.axes, body.skeleton.axes, atol=1e-12)
    apart = turned.inv() * Rotation.from_quat(tilted, scalar_first=True)
    assert apart.magnitude().max() < 1e-5
    assert back.rate == pytest.approx(25.0, rel=1e-5)
    other = eqx.tree_at(lambda b: b.skeleton, body, skeleton)
    for frame in range(3):
        here, there = _pose_body(body, motion[frame]), _pose_body(other, back[frame])
        np.testing.assert_allclose(there.vertices, here.vertices, atol=1e-5)
        np.testing.assert_allclose(there.pose.translations, here.pose.translations, atol=1e-5)
        assert there.pose.scale == pytest.approx(float(here.pose.scale), rel=1e-5)
    twice = read_gltf(tmp_path / "chain.glb", rate=50.0)[1]
    assert len(twice) == 5
    np.testing.assert_allclose(twice.poses.scale[2], 1.2, rtol=1e-5)
    write_gltf(tmp_path / "still.glb", body)
    assert read_gltf(tmp_path / "still.glb")[1] is None


def test_a_body_comes_back(tmp_path, rng):
    """Vertices in their order, faces, weights to the bit of the file; and where the motion takes them."""
    body = chain_body("linear")
    motion = stack_poses([random_pose(body.skeleton, rng, 0.8, scale) for scale in (1.0, 1.2)], rate=25.0)
    write_gltf(tmp_path / "chain.glb", body, motion)
    back, moved = read_gltf_body(tmp_path / "chain.glb")
    np.testing.assert_array_equal(back.faces, body.faces)
    np.testing.assert_allclose(back.vertices, body.vertices, atol=1e-6)
    np.testing.assert_allclose(back.skin.weights, body.skin.weights, atol=1e-6)
    for frame in range(2):
        there = _pose_body(back, moved[frame]).vertices
        np.testing.assert_allclose(there, _pose_body(body, motion[frame]).vertices, atol=1e-5)
    write_gltf(tmp_path / "still.glb", body)
    assert read_gltf_body(tmp_path / "still.glb")[1] is None


def test_damaged_files_are_said(tmp_path):
    write_gltf(tmp_path / "body.glb", chain_body("linear"))
    whole = (tmp_path / "body.glb").read_bytes()
    (tmp_path / "cut.glb").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.glb").write_text("not a model")
    trimesh.creation.icosphere(1).export(tmp_path / "ball.glb")
    for name, sentence in (
        ("cut", "incomplete"),
        ("text", "incomplete"),
        ("ball", "no skin"),
        ("none", "no such file"),
    ):
        with pytest.raises(InputError, match=sentence):
            read_gltf(tmp_path / f"{name}.glb")
