"""USD: what OpenUSD's own skinning makes of the file is what `pose_body` says, and what cannot be written."""

import builtins

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import deform_all
from jaxcap.body.pose import stack_poses
from jaxcap.body.skeleton import Skeleton
from jaxcap.errors import InputError
from jaxcap.io.usd import write_usd

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
    for frame, vertices in enumerate(np.asarray(deform_all(body, motion.poses))):
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
        ("body.usda", chain_body("swing_twist"), motion, "linearise it first"),
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
    with pytest.raises(InputError, match=r"pip install 'jaxcap\[usd\]'"):
        write_usd(tmp_path / "body.usda", body, motion)
    assert not list(tmp_path.iterdir())
