"""USD: what OpenUSD's own skinning makes of the file is what `pose_body` says, and what cannot be written."""

import builtins
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import stack_poses
from jaxcap.body.skeleton import Skeleton
from jaxcap.errors import InputError
from jaxcap.io.skinned.bind_pose import invert_affine
from jaxcap.io.usd import usd_child
from jaxcap.io.usd.usd import write_usd
from jaxcap.io.usd.usd_reader import read_usd_body

pxr = pytest.importorskip("pxr")


def askew(skin="linear"):
    """Frames of the joints at random, and names that USD does not take."""
    body = chain_body(skin)
    tilted = Rotation.random(body.skeleton.num_joints, random_state=3).as_quat(scalar_first=True)
    s = body.skeleton
    names = ("root", "spine 1", "spine_1", "3", *s.names[4:])
    skeleton = Skeleton(names, s.parents, s.kinds, s.centres, jnp.asarray(tilted), s.axes)
    return eqx.tree_at(lambda b: b.skeleton, body, skeleton)


class Reader:
    """The skinning of UsdSkel."""

    def __init__(self, path):
        from pxr import Usd, UsdSkel

        self.stage = Usd.Stage.Open(str(path))
        root, everything = UsdSkel.Root(self.stage.GetDefaultPrim()), Usd.PrimDefaultPredicate
        self.cache = UsdSkel.Cache()
        self.cache.Populate(root, everything)
        (binding,) = self.cache.ComputeSkelBindings(root, everything)
        (self.target,) = binding.GetSkinningTargets()
        self.skeleton = binding.GetSkeleton()
        self.query = self.cache.GetSkelQuery(self.skeleton)

    def vertices(self, time):
        from pxr import UsdGeom, Vt

        points = Vt.Vec3fArray(UsdGeom.Mesh(self.target.GetPrim()).GetPointsAttr().Get())
        assert self.target.ComputeSkinnedPoints(self.query.ComputeSkinningTransforms(time), points, time)
        world = np.array(UsdGeom.XformCache(time).GetLocalToWorldTransform(self.skeleton.GetPrim()))
        return np.array(points) @ world[:3, :3] + world[3, :3]

    def complaints(self):
        """Of all of OpenUSD's validators."""
        from pxr import UsdValidation

        every = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
        return [error.GetMessage() for error in UsdValidation.ValidationContext(every).Validate(self.stage)]


@pytest.mark.parametrize(("skin", "suffix"), [("linear", ".usda"), ("rigid", ".usdc"), ("linear", ".usdz")])
def test_skinning_is_that_of_pose_body(tmp_path, rng, skin, suffix):
    from pxr import UsdGeom

    body = askew(skin)
    scales = (1.0, 1.2, 0.9) if suffix == ".usda" else (1.037, 1.037, 1.037)
    motion = stack_poses([random_pose(body.skeleton, rng, 0.8, scale) for scale in scales], rate=25.0)
    path = tmp_path / f"body{suffix}"
    write_usd(path, body, motion)
    assert list(tmp_path.iterdir()) == [path]
    reader = Reader(path)
    for frame, vertices in enumerate(np.asarray(posed_vertices(body, motion.poses))):
        np.testing.assert_allclose(reader.vertices(frame), vertices, atol=2e-6)
    stage = reader.stage
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 25.0
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 2)
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert tuple(reader.skeleton.GetJointNamesAttr().Get()) == body.skeleton.names
    assert reader.complaints() == []
    # faces look outwards, as they did
    faces = UsdGeom.Mesh(reader.target.GetPrim()).GetFaceVertexIndicesAttr().Get()
    np.testing.assert_array_equal(np.array(faces).reshape(-1, 3), body.faces)


def test_half_way_between_frames_a_joint_is_half_way(tmp_path, rng):
    """Whatever the signs of the quaternions that poses hold."""
    body = askew()
    motion = stack_poses([random_pose(body.skeleton, rng, 0.3) for _ in range(4)])
    signs = jnp.asarray(rng.choice([-1.0, 1.0], size=(4, body.skeleton.num_joints, 1)))
    motion = eqx.tree_at(lambda m: m.poses.rotations, motion, motion.poses.rotations * signs)
    write_usd(tmp_path / "body.usdc", body, motion)
    reader = Reader(tmp_path / "body.usdc")
    animation = reader.query.GetAnimQuery()
    for frame in range(3):
        turns = []
        for time in (frame, frame + 0.5, frame + 1):
            quaternions = animation.ComputeJointLocalTransformComponents(time)[1]
            turns.append(Rotation.from_quat([[*q.GetImaginary(), q.GetReal()] for q in quaternions]))
        before, between, after = turns
        np.testing.assert_allclose(
            (before.inv() * between).magnitude(), (between.inv() * after).magnitude(), atol=1e-5
        )
        assert (before.inv() * after).magnitude().max() < np.pi


def test_a_body_at_rest(tmp_path):
    body = askew()
    write_usd(tmp_path / "body.usda", body)
    reader = Reader(tmp_path / "body.usda")
    np.testing.assert_allclose(reader.vertices(0), body.vertices, atol=1e-6)
    assert not reader.stage.HasAuthoredTimeCodeRange()
    assert reader.complaints() == []


def test_what_cannot_be_written_is_said(tmp_path, rng, monkeypatch):
    body = askew()
    motion = stack_poses([random_pose(body.skeleton, rng)])
    for name, given, moves, said in (
        ("body.usd", body, motion, "use .usda, .usdc, .usdz"),
        ("body.usda", chain_body("swing_twist"), motion, "to_linear_blend` first"),
        ("body.usda", body, motion.slice(slice(0, 0)), "no frames"),
        ("none/body.usdz", body, motion, "cannot be written"),
        ("none/body.usda", body, motion, "cannot be written"),
    ):
        with pytest.raises(InputError, match=said):
            write_usd(tmp_path / name, given, moves)
    plain = builtins.__import__

    def without(name, *rest):
        if name == "pxr":
            raise ImportError(name)
        return plain(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"pip install -e '.\[usd\]'"):
        write_usd(tmp_path / "body.usda", body, motion)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usdz"])
def test_a_body_and_its_motion_come_back(tmp_path, rng, suffix):
    body = askew()
    motion = stack_poses(
        [random_pose(body.skeleton, rng, 0.8, scale) for scale in (1.0, 1.2, 0.9)], rate=25.0
    )
    write_usd(tmp_path / f"body{suffix}", body, motion)
    back, moved = read_usd_body(tmp_path / f"body{suffix}")
    assert (back.skeleton.names, back.skeleton.parents) == (body.skeleton.names, body.skeleton.parents)
    np.testing.assert_array_equal(back.faces, body.faces)
    np.testing.assert_allclose(back.vertices, body.vertices, atol=1e-6)
    assert (len(moved), moved.rate) == (3, 25.0)
    there = posed_vertices(back, moved.poses)
    np.testing.assert_allclose(there, posed_vertices(body, motion.poses), atol=1e-5)
    write_usd(tmp_path / f"still{suffix}", body)
    assert read_usd_body(tmp_path / f"still{suffix}")[1] is None


def quadrangles(faces: np.ndarray) -> list[list[int]]:
    """Triangles as polygons, of which two that follow each other as a fan are one."""
    polygons: list[list[int]] = []
    for a, b, c in faces.tolist():
        if polygons and len(polygons[-1]) == 3 and (polygons[-1][0], polygons[-1][2]) == (a, b):
            polygons[-1].append(c)
        else:
            polygons.append([a, b, c])
    return polygons


def test_a_body_of_another_program(tmp_path, rng):
    """Centimetres and z up, polygons, half a rate of keys, joints of a mesh in an order of their own, and what OpenUSD makes of it."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

    body = askew()
    motion = stack_poses([random_pose(body.skeleton, rng, 0.5) for _ in range(3)], rate=24.0)
    write_usd(tmp_path / "own.usda", body, motion)
    stage = Usd.Stage.Open(str(tmp_path / "own.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    # the same thing in the world: below a node that undoes both
    root = UsdGeom.Xformable(stage.GetDefaultPrim())
    root.AddRotateXOp().Set(90.0)
    root.AddScaleOp().Set(Gf.Vec3f(100.0))
    stage.SetTimeCodesPerSecond(48.0)
    stage.SetFramesPerSecond(48.0)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Body/Surface"))
    polygons = quadrangles(np.asarray(body.faces))
    assert any(len(polygon) == 4 for polygon in polygons)
    mesh.GetFaceVertexCountsAttr().Set(Vt.IntArray([len(polygon) for polygon in polygons]))
    mesh.GetFaceVertexIndicesAttr().Set(Vt.IntArray(np.concatenate(polygons).tolist()))
    binding = UsdSkel.BindingAPI(mesh.GetPrim())
    order = list(UsdSkel.Skeleton(stage.GetPrimAtPath("/Body/Skeleton")).GetJointsAttr().Get())
    binding.CreateJointsAttr(Vt.TokenArray(order[::-1]))
    indices = np.array(binding.GetJointIndicesAttr().Get())
    binding.GetJointIndicesAttr().Set(Vt.IntArray((len(order) - 1 - indices).tolist()))
    move = Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(1, 2, 3))
    mesh.GetPointsAttr().Set(
        Vt.Vec3fArray([Gf.Vec3f(p) - Gf.Vec3f(1, 2, 3) for p in mesh.GetPointsAttr().Get()])
    )
    binding.GetGeomBindTransformAttr().Set(move)
    stage.Export(str(tmp_path / "foreign.usd"))
    back, moved = read_usd_body(tmp_path / "foreign.usd")
    assert moved.rate == 48.0 and len(moved) == 3
    np.testing.assert_array_equal(back.faces, body.faces)
    np.testing.assert_allclose(back.vertices, body.vertices, atol=1e-5)
    np.testing.assert_allclose(moved.poses.scale, 1.0, atol=1e-5)
    np.testing.assert_allclose(
        posed_vertices(back, moved.poses), posed_vertices(body, motion.poses), atol=1e-4
    )


def test_what_is_not_read_is_said(tmp_path):
    from pxr import Usd, UsdGeom

    (tmp_path / "text.usda").write_text("not a stage")
    stage = Usd.Stage.CreateNew(str(tmp_path / "ball.usda"))
    UsdGeom.Sphere.Define(stage, "/Ball")
    stage.Save()
    write_usd(tmp_path / "body.usdc", chain_body("linear"))
    whole = (tmp_path / "body.usdc").read_bytes()
    (tmp_path / "cut.usdc").write_bytes(whole[: len(whole) // 2])
    for name, sentence in (
        ("text.usda", "this USD file is incomplete or damaged"),
        ("cut.usdc", "this USD file is incomplete or damaged"),
        ("ball.usda", "there is no skin in it"),
        ("none.usda", "no such file"),
        ("body.bvh", "USD is not read from"),
    ):
        with pytest.raises(InputError, match=sentence):
            read_usd_body(tmp_path / name)


def test_a_rotation_of_no_length_is_told_with_its_prim_and_time(tmp_path, rng):
    """In an animation, at rest of it, and where the skeleton stands."""
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    body = askew()
    motion = stack_poses([random_pose(body.skeleton, rng) for _ in range(3)])
    for name, time, said in (
        ("moving", 2.0, r"moving\.usda: '/Body/Skeleton/Motion\.rotations' has a zero quaternion at time 2, of joint "),
        ("still", None, r"still\.usda: '/Body/Skeleton/Motion\.rotations' has a zero quaternion, of joint '"),
        ("placed", None, r"placed\.usda: '/Body\.xformOp:orient' has a zero quaternion; write a unit quaternion"),
    ):  # fmt: skip
        path = tmp_path / f"{name}.usda"
        write_usd(path, body, motion)
        stage = Usd.Stage.Open(str(path))
        turns = UsdSkel.Animation(stage.GetPrimAtPath("/Body/Skeleton/Motion")).GetRotationsAttr()
        if name == "placed":
            UsdGeom.Xformable(stage.GetDefaultPrim()).AddOrientOp().Set(Gf.Quatf(0, 0, 0, 0))
        else:
            values = turns.Get(0)
            values[1] = Gf.Quatf(0, 0, 0, 0)
            if time is None:
                turns.Clear()
                turns.Set(values)
            else:
                turns.Set(values, time)
        stage.Save()
        with pytest.raises(InputError, match=said):
            read_usd_body(path)


def test_text_that_openusd_cannot_parse_is_told_by_its_line(tmp_path):
    write_usd(tmp_path / "body.usda", chain_body())
    text = (tmp_path / "body.usda").read_text()
    line = text[: text.index("def Mesh")].count("\n") + 1
    (tmp_path / "syntax.usda").write_text(text.replace("def Mesh", "dex Mesh"))
    points = text.index("point3f[] points")
    (tmp_path / "cut.usda").write_text(text[: points + 60])
    (tmp_path / "layers.usda").write_text("#usda 1.0\n(\n    subLayers = [@./syntax.usda@]\n)\n")
    for name, said in (
        ("syntax", rf"syntax\.usda:{line}: 'dex Mesh .*' is unexpected, in /Body; this USD file is incomplete"),
        ("cut", rf"cut\.usda:{text[:points].count(chr(10)) + 1}: .*(the text ends|is unexpected), in /Body/Surface"),
        ("layers", rf"layers\.usda: .*syntax\.usda:{line}: 'dex Mesh"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=said) as raised:
            read_usd_body(tmp_path / f"{name}.usda")
        assert "()" not in str(raised.value) and "pxrInternal" not in str(raised.value)


@pytest.mark.parametrize("arc", ["sublayer", "reference", "payload"])
def test_layers_outside_of_the_folder_are_not_read(tmp_path, rng, arc):
    """The body lies in a layer next to the file's folder; in the folder it is read."""
    from pxr import Usd, UsdGeom

    body = chain_body()
    (tmp_path / "in").mkdir()
    write_usd(tmp_path / "body.usda", body)
    write_usd(tmp_path / "in" / "body.usda", body)
    for name, folder in (("inside", "."), ("outside", "..")):
        stage = Usd.Stage.CreateNew(str(tmp_path / "in" / f"{name}.usda"))
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        asset = f"{folder}/body.usda"
        if arc == "sublayer":
            stage.GetRootLayer().subLayerPaths.append(asset)
        elif arc == "reference":
            stage.DefinePrim("/A").GetReferences().AddReference(asset)
        else:
            stage.DefinePrim("/A").GetPayloads().AddPayload(asset)
        stage.GetRootLayer().Save()
    again, _ = read_usd_body(tmp_path / "in" / "inside.usda")
    np.testing.assert_allclose(again.vertices, body.vertices, atol=1e-6)
    with pytest.raises(InputError, match="it refers to '../body.usda', which is outside of its folder"):
        read_usd_body(tmp_path / "in" / "outside.usda")


@pytest.mark.parametrize(
    ("program", "told"),
    [
        ("import os; os.abort()", "OpenUSD crashes with this file, SIGABRT"),
        ("import sys; sys.exit('bad')", "OpenUSD fails with this file, bad"),
        ("import time; time.sleep(60)", "OpenUSD does not end within 2 s"),
    ],
)
def test_a_file_that_brings_openusd_down_is_refused(tmp_path, monkeypatch, program, told):
    write_usd(tmp_path / "body.usdc", chain_body("linear"))
    (tmp_path / "program.py").write_text(program)
    monkeypatch.setattr(usd_child, "_PROGRAM", tmp_path / "program.py")
    monkeypatch.setattr(usd_child, "_WAIT", 2 if "sleep" in program else 60)
    with pytest.raises(InputError, match=f"this USD file is incomplete or damaged .{told}.; export it again"):
        read_usd_body(tmp_path / "body.usdc")


def test_transforms_beyond_all_numbers_are_refused_without_a_warning():
    """Their lengths and determinants overflow."""
    with pytest.raises(InputError, match="cannot be inverted"):
        invert_affine(Path("body.usdc"), np.diag([1e200, 1e200, 1e200, 1.0])[None])
