"""Bodies of other programs: what glTF allows and `write_gltf` never makes."""

import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pygltflib
import pytest
from helpers import chain_body, random_pose
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from jaxcap.body.pose import Motion, stack_poses
from jaxcap.edit.linear_blend.influences import limit_influences
from jaxcap.errors import InputError
from jaxcap.io.gltf.gltf import write_gltf
from jaxcap.io.gltf.gltf_clock import count_grid_steps
from jaxcap.io.gltf.gltf_reader import read_gltf, read_gltf_body
from tests.io.skinned.test_gltf import Viewer, _pose_body

#: from the space of the file, centimetres and z up, into the world
TURN = Rotation.from_euler("x", -90, degrees=True)
SIZE = 0.01
#: where the second mesh is in the world, and how far away from there it was bound
ASIDE, BOUND = np.array([0.4, 0.0, 0.1]), np.array([7.0, -3.0, 2.0])


@pytest.fixture
def chain(tmp_path, rng):
    """A body, its motion, and what `write_gltf` makes of them."""
    body = limit_influences(chain_body("linear"), 4)
    motion = stack_poses([random_pose(body.skeleton, rng, 0.5) for _ in range(3)], rate=25.0)
    write_gltf(tmp_path / "chain.glb", body, motion)
    return body, motion, tmp_path / "chain.glb"


class Rewriter:
    """A file of `write_gltf` taken apart, to be written in another program's way."""

    def __init__(self, path):
        self.path, self.old = path, Viewer(path)
        self.file = self.old.file
        self.blob = bytearray(self.old.blob)

    def add(
        self, values: np.ndarray, kind: str, start: int | None = None, stride: int | None = None, **more
    ) -> int:
        """The accessor of an array, of its own or within one that is there already."""
        numbers = {np.dtype(dtype): code for code, dtype in ((5121, "u1"), (5123, "<u2"), (5126, "<f4"))}
        if start is None:
            self.blob += b"\0" * (-len(self.blob) % 4)
            start = len(self.blob)
            self.blob += values.tobytes()
            self.old.blob = bytes(self.blob)
        self.file.bufferViews.append(pygltflib.BufferView(buffer=0, byteOffset=start, byteLength=len(self.blob) - start, byteStride=stride))  # fmt: skip
        view = len(self.file.bufferViews) - 1
        self.file.accessors.append(pygltflib.Accessor(bufferView=view, componentType=numbers[values.dtype], count=len(values), type=kind, **more))  # fmt: skip
        return len(self.file.accessors) - 1

    def above(self, joint: int, turn: Rotation, size: float) -> None:
        """A joint told in the space of something that turns it and makes it larger."""
        node = self.file.nodes[joint]
        node.translation = (turn.inv().apply(node.translation) / size).tolist()
        node.rotation = (turn.inv() * Rotation.from_quat(node.rotation)).as_quat().tolist()
        animation = self.file.animations[0]
        for channel in animation.channels:
            if channel.target.node != joint:
                continue
            sampler = animation.samplers[channel.sampler]
            values = self.old.array(sampler.output).astype(float)
            if channel.target.path == "translation":
                sampler.output = self.add((turn.inv().apply(values) / size).astype("<f4"), "VEC3")
            else:
                turned = (turn.inv() * Rotation.from_quat(values)).as_quat()
                sampler.output = self.add(turned.astype("<f4"), "VEC4")

    def mesh(self, vertices: np.ndarray, old: pygltflib.Attributes, faces: np.ndarray) -> pygltflib.Mesh:
        """Every triangle with vertices of its own; places and weights, as shares of 65535, in turn."""
        corners = faces.reshape(-1)
        rows = np.zeros(len(corners), [("place", "<f4", 3), ("weights", "<u2", 4), ("joints", "u1", 4)])
        rows["place"] = vertices[corners]
        rows["weights"] = np.round(65535 * self.old.array(old.WEIGHTS_0))[corners]
        rows["joints"] = self.old.array(old.JOINTS_0)[corners]
        self.blob += b"\0" * (-len(self.blob) % 4)
        start = len(self.blob)
        self.blob += rows.tobytes()
        names = pygltflib.Attributes(
            POSITION=self.add(rows["place"], "VEC3", start, rows.itemsize),
            WEIGHTS_0=self.add(rows["weights"], "VEC4", start + 12, rows.itemsize, normalized=True),
            JOINTS_0=self.add(rows["joints"], "VEC4", start + 20, rows.itemsize),
        )
        return pygltflib.Mesh(primitives=[pygltflib.Primitive(attributes=names, mode=4)])

    def save(self, path) -> None:
        self.file.buffers = [pygltflib.Buffer(byteLength=len(self.blob))]
        self.file.set_binary_blob(bytes(self.blob))
        self.file.save_binary(str(path))


def test_a_body_of_another_program(chain, tmp_path):
    """Centimetres and z up below a node that sets both right, a node between two joints, every triangle with vertices
    of its own, interleaved, weights as integers, and a second skin of the same joints, bound elsewhere."""
    body, motion, path = chain
    new = Rewriter(path)
    file, skin = new.file, new.file.skins[0]
    root, top = skin.joints[0], skin.skeleton
    inverse = new.old.array(skin.inverseBindMatrices).astype(float).reshape(-1, 4, 4).swapaxes(1, 2)
    into = np.eye(4)
    into[:3, :3] = SIZE * TURN.as_matrix()
    # joints as large as in the world, in a space of centimetres
    bind = inverse @ into
    bind[:, :3] /= SIZE
    file.nodes[top].scale, file.nodes[top].rotation = [SIZE] * 3, TURN.as_quat().tolist()
    for joint in skin.joints:
        new.above(joint, TURN if joint == root else Rotation.identity(), SIZE)
    between = Rotation.from_euler("zy", [90, 30], degrees=True)
    child = next(joint for joint in skin.joints if not file.nodes[joint].children)
    (parent,) = [node for node in file.nodes if child in (node.children or [])]
    matrix = np.eye(4)
    matrix[:3, :3] = between.as_matrix()
    new.above(child, between, 1.0)
    file.nodes.append(pygltflib.Node(matrix=matrix.T.reshape(-1).tolist(), children=[child]))
    parent.children = [len(file.nodes) - 1 if node == child else node for node in parent.children]
    shift = np.eye(4)
    shift[:3, 3] = -BOUND
    skin.inverseBindMatrices = new.add(bind.swapaxes(1, 2).astype("<f4"), "MAT4")
    elsewhere = (bind @ shift).swapaxes(1, 2)[::-1].astype("<f4")
    other = pygltflib.Skin(joints=skin.joints[::-1], inverseBindMatrices=new.add(elsewhere.copy(), "MAT4"))
    file.skins.append(other)
    old = file.meshes[0].primitives[0].attributes
    here = TURN.inv().apply(np.array(body.vertices, float)) / SIZE
    there = TURN.inv().apply(np.array(body.vertices, float) + ASIDE) / SIZE + BOUND
    faces = np.asarray(body.faces)
    file.meshes = [new.mesh(here, old, faces), new.mesh(there, old, faces)]
    # its joints are the same ones the other way round
    numbers = file.meshes[1].primitives[0].attributes
    turned = (len(skin.joints) - 1 - new.old.array(old.JOINTS_0)[faces.reshape(-1)]).astype("u1")
    numbers.JOINTS_0 = new.add(turned, "VEC4")
    file.nodes.append(pygltflib.Node(mesh=1, skin=1, translation=[9.0, 9.0, 9.0]))
    new.save(tmp_path / "foreign.glb")

    back, moved = read_gltf_body(tmp_path / "foreign.glb")
    assert back.skeleton.names == body.skeleton.names
    assert back.skeleton.parents == body.skeleton.parents
    np.testing.assert_allclose(back.skeleton.centres, body.skeleton.centres, atol=1e-5)
    used = np.unique(faces)
    assert len(back.faces) == 2 * len(faces)
    assert len(back.vertices) == 2 * len(used)
    aside = eqx.tree_at(lambda b: b.vertices, body, body.vertices + jnp.asarray(ASIDE))
    for frame in range(3):
        assert moved.poses.scale[frame] == pytest.approx(1.0, abs=1e-5)
        found = np.asarray(_pose_body(back, moved[frame]).vertices)
        both = [np.asarray(_pose_body(whole, motion[frame]).vertices)[used] for whole in (body, aside)]
        apart = np.linalg.norm(np.concatenate(both)[:, None] - found[None], axis=2)
        assert max(apart.min(1).max(), apart.min(0).max()) < 1e-4


def test_spline_keys_are_sampled_as_scipy_does(chain, tmp_path, rng):
    """Slopes of a key differ before and behind it, which SciPy is asked of each piece."""
    _, _, path = chain
    new = Rewriter(path)
    animation, root = new.file.animations[0], new.file.skins[0].joints[0]
    for channel in animation.channels:
        sampler = animation.samplers[channel.sampler]
        values, times = (new.old.array(number).astype(float) for number in (sampler.output, sampler.input))
        slopes = rng.normal(size=(2, *values.shape))
        keys = np.stack([slopes[0], values, slopes[1]], 1).astype("<f4")
        kind = "VEC3" if values.shape[1] == 3 else "VEC4"
        sampler.output, sampler.interpolation = (
            new.add(keys.reshape(-1, values.shape[1]), kind),
            "CUBICSPLINE",
        )
        if channel.target.node == root and channel.target.path == "translation":
            known = times.reshape(-1), keys.astype(float)
    new.save(tmp_path / "spline.glb")

    moved = read_gltf_body(tmp_path / "spline.glb", rate=200.0)[1]
    times, keys = known
    clock = times[0] + np.arange(len(moved)) / 200.0
    expected = np.zeros((len(clock), 3))
    for k in range(len(times) - 1):
        piece = CubicHermiteSpline(times[k : k + 2], keys[k : k + 2, 1], [keys[k, 2], keys[k + 1, 0]])
        here = (clock >= times[k]) & (clock <= times[k + 1] + 1e-6)
        expected[here] = piece(clock[here])
    assert len(clock) == 17
    np.testing.assert_allclose(
        moved.poses.translations[:, 0] - moved.poses.translations[0, 0], expected - expected[0], atol=1e-5
    )
    file = pygltflib.GLTF2().load(str(tmp_path / "spline.glb"))
    file.animations[0].samplers[0].interpolation = "LINEAR"
    file.save_binary(str(tmp_path / "short.glb"))
    with pytest.raises(InputError, match="3 times and 9 values; expected 1 for each"):
        read_gltf_body(tmp_path / "short.glb")


def test_what_is_not_read_is_said(chain, tmp_path):
    _, _, path = chain

    def compressed(file):
        file.extensionsRequired = ["KHR_draco_mesh_compression"]

    def strips(file):
        file.meshes[0].primitives[0].mode = 5

    def mirrored(file):
        file.nodes[file.skins[0].skeleton].scale = [-1.0, 1.0, 1.0]

    def bare(file):
        for node in file.nodes:
            node.mesh = node.skin = None

    for change, sentence in (
        (compressed, "export it without compression"),
        (strips, "export it as triangles"),
        (mirrored, "zero scale or mirrors"),
        (bare, "no mesh in this file is skinned"),
    ):
        file = pygltflib.GLTF2().load(str(path))
        change(file)
        file.save_binary(str(tmp_path / "changed.glb"))
        with pytest.raises(InputError, match=sentence):
            read_gltf_body(tmp_path / "changed.glb")
    assert isinstance(read_gltf_body(path)[1], Motion)


def test_a_second_figure_is_left_out_with_a_word(chain, tmp_path):
    """Two figures in one file: the joints, skin and mesh of the first once more."""
    body, _, path = chain
    new = Rewriter(path)
    file, skin = new.file, new.file.skins[0]
    first = len(file.nodes)
    for joint in skin.joints:
        old = file.nodes[joint]
        file.nodes.append(pygltflib.Node(name=f"other {old.name}", translation=old.translation))
    others = list(range(first, len(file.nodes)))
    file.skins.append(pygltflib.Skin(joints=others, inverseBindMatrices=skin.inverseBindMatrices))
    file.nodes.append(pygltflib.Node(name="Twin", mesh=0, skin=1))
    file.nodes[others[0]].children = others[1:]
    file.scenes[0].nodes += [others[0], len(file.nodes) - 1]
    new.save(tmp_path / "two.glb")
    with pytest.warns(UserWarning, match=r"two.glb: not read: other figures, .* \(Twin\)"):
        back, _ = read_gltf_body(tmp_path / "two.glb")
    assert len(back.faces) == len(body.faces)


def test_what_else_a_file_holds_is_told(chain, tmp_path):
    """A hat on a joint, and a shape key."""
    _, _, path = chain
    new = Rewriter(path)
    file = new.file
    file.nodes.append(pygltflib.Node(name="Hat", mesh=0))
    file.nodes[file.skins[0].joints[0]].children.append(len(file.nodes) - 1)
    mesh = next(node for node in file.nodes if node.skin is not None)
    mesh.name = "Face"
    primitive = file.meshes[mesh.mesh].primitives[0]
    primitive.targets = [pygltflib.Attributes(POSITION=primitive.attributes.POSITION)]
    new.save(tmp_path / "more.glb")
    with pytest.warns(UserWarning, match=r"more.glb: not read: .*\(Hat\); .*\(Face\)\.$"):
        read_gltf_body(tmp_path / "more.glb")
    # what hangs on a skeleton is asked for with a body only
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_gltf(tmp_path / "more.glb")


def moving_two(chain, tmp_path, finger: np.ndarray):
    """A file whose root has keys at 0 and 4 s, and whose second joint has them at times of its own."""
    new = Rewriter(chain[2])
    file = new.file
    joints, animation = file.skins[0].joints, file.animations[0]
    turns = Rotation.from_rotvec(0.5 * np.outer(finger / 4.0, [0, 0, 1.0])).as_quat()
    animation.samplers = [
        pygltflib.AnimationSampler(input=new.add(np.array([0, 4.0], "<f4"), "SCALAR"),
                                   output=new.add(np.array([[0, 0, 0], [0, 0, 2.0]], "<f4"), "VEC3")),
        pygltflib.AnimationSampler(input=new.add(finger.astype("<f4"), "SCALAR"),
                                   output=new.add(turns.astype("<f4"), "VEC4")),
    ]  # fmt: skip
    animation.channels = [
        pygltflib.AnimationChannel(sampler=number, target=pygltflib.AnimationChannelTarget(node=node, path=path))
        for number, (node, path) in enumerate(((joints[0], "translation"), (joints[1], "rotation")))
    ]  # fmt: skip
    new.save(tmp_path / "two.glb")
    return tmp_path / "two.glb"


def test_a_motion_lasts_from_the_first_key_of_any_joint_to_the_last(chain, tmp_path):
    """The joint with most keys stands still after a second, while the body walks on."""
    path = moving_two(chain, tmp_path, np.arange(26) / 25)
    _, motion = read_gltf(path)
    assert (len(motion), motion.rate) == (101, pytest.approx(25.0))
    way = np.asarray(motion.poses.translations)[:, 0]
    steps = np.linalg.norm(np.diff(way, axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.02, atol=1e-5)
    # a rate that divides no key
    assert len(read_gltf(path, rate=7.0)[1]) == 29


def test_keys_on_no_grid_are_sampled_with_a_word(chain, tmp_path, rng):
    path = moving_two(chain, tmp_path, np.sort(rng.uniform(0, 3, 20)))
    with pytest.warns(UserWarning, match=r"two.glb: the key times .* not regular; .* 30 frames per second"):
        motion = read_gltf(path)[1]
    assert (len(motion), motion.rate) == (121, pytest.approx(30.0))


@pytest.mark.parametrize("rate", [24.0, 25.0, 29.97, 60.0, 120.0])
def test_the_grid_of_keys_is_found(rng, rate):
    """Where few of its times have keys, in single precision; the ends and two neighbours among them."""
    kept = np.unique([0, 7, 8, 900, *rng.integers(0, 900, 12)])
    times = (np.float32(2.0) + (kept / rate).astype("<f4")).astype(float)
    assert count_grid_steps(times) == 900
    assert count_grid_steps(times[:1]) == 0
