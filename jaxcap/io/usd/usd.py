"""Skinned, animated bodies as USD (`.usda`, `.usdc`, `.usdz`), by OpenUSD's own library, the extra `usd`.

The schema is UsdSkel: a `SkelRoot` with the body's `Skeleton`, its `SkelAnimation` and one `Mesh` with linear
blend skinning (OpenUSD, "UsdSkel: API overview", skinning). Joints have their own frames, as in glTF. The
poses' scale is in the root's transform, as an animation stores the scale of its joints in half precision.
"""

# pxr fills its modules as it is imported and has no stubs
# pyright: reportAttributeAccessIssue=false

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...geometry.mesh import vertex_normals
from ..skinned.skinned import (
    bind_frames,
    check_linear_skin,
    check_motion,
    influences,
    moving_frames,
    rest_frames,
)
from ..system.atomic import atomic_path

if TYPE_CHECKING:
    from pxr import Usd, UsdSkel

#: text, binary, and zipped for phones
SUFFIXES = (".usda", ".usdc", ".usdz")


@checked
def write_usd(path: str | Path, body: Body, motion: Motion | None = None) -> None:
    """Write a body, with an optional motion as its animation, in metres, y up, one time code for each frame.

    All influences are kept, the strongest first. Joint names that are invalid in USD are changed where
    required, and unchanged in `jointNames`.

    **Raises:** `InputError` if usd-core is not installed, the suffix is not in `SUFFIXES`, the skin is not
    linear, the motion has other joints or no frames, or the file cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: USD is not written as '{path.suffix}' files; use {', '.join(SUFFIXES)}.")
    try:
        from pxr import Tf, Usd, UsdUtils
    except ImportError:
        raise InputError(
            f"{path}: writing USD needs the library usd-core, which is not installed; run pip install -e '.[usd]' in a checkout of jaxcap."
        ) from None
    check_linear_skin(path, body, "USD")
    check_motion(path, body.skeleton, motion)
    # OpenUSD creates files in the folder it chooses; only a successful result is moved to `path`
    with atomic_path(path) as beside, tempfile.TemporaryDirectory() as folder:
        layer, package = Path(folder) / path.with_suffix(".usdc").name, Path(folder) / path.name
        try:
            stage = Usd.Stage.CreateNew(str(layer if path.suffix.lower() == ".usdz" else package))
            _write_stage(stage, body, motion)
            stage.GetRootLayer().Save()
            if path.suffix.lower() == ".usdz":
                UsdUtils.CreateNewUsdzPackage(str(layer), str(package))
            made = package.read_bytes()
        except (Tf.ErrorException, OSError) as error:
            reason = str(error).strip().splitlines()[-1].strip()
            raise InputError(f"{path}: OpenUSD cannot write it ({reason[:200]}); write it as .glb.") from None
        beside.write_bytes(made)


def _write_stage(stage: "Usd.Stage", body: Body, motion: Motion | None) -> None:
    from pxr import Gf, Kind, Sdf, Usd, UsdGeom, UsdSkel, Vt

    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, "/Body")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    skeleton = UsdSkel.Skeleton.Define(stage, "/Body/Skeleton")
    rest = rest_frames(body.skeleton)
    skeleton.CreateJointsAttr(Vt.TokenArray(_joint_paths(body.skeleton)))
    skeleton.CreateJointNamesAttr(Vt.TokenArray(list(body.skeleton.names)))
    # transposed, as points are rows in USD
    bind = bind_frames(body.skeleton).swapaxes(1, 2)
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(bind)))
    skeleton.CreateRestTransformsAttr(
        Vt.Matrix4dArray(
            [
                Gf.Matrix4d(1.0).SetRotate(Gf.Quatd(turn[3], *turn[:3])).SetTranslateOnly(Gf.Vec3d(*place))
                for place, turn in zip(rest.positions.tolist(), rest.quaternions.tolist(), strict=True)
            ]
        )
    )
    _surface(stage, skeleton, body)
    if motion is not None:
        stage.SetTimeCodesPerSecond(motion.rate)
        stage.SetFramesPerSecond(motion.rate)
        stage.SetStartTimeCode(0)
        stage.SetEndTimeCode(motion.num_frames - 1)
        _write_animation(stage, skeleton, body.skeleton, motion)
        scales = np.asarray(motion.poses.scale, float)
        if (scales != 1).any():
            size = UsdGeom.Xformable(root).AddScaleOp(UsdGeom.XformOp.PrecisionDouble)
            if (scales == scales[0]).all():
                size.Set(Gf.Vec3d(scales[0]))
            else:
                for frame, scale in enumerate(scales.tolist()):
                    size.Set(Gf.Vec3d(scale), frame)
    times = [Usd.TimeCode.Default()] if motion is None else range(motion.num_frames)
    with Sdf.ChangeBlock():
        boxes = [
            (time, boxed, UsdGeom.Boundable.ComputeExtentFromPlugins(boxed, time))
            for boxed in (UsdGeom.Boundable(skeleton), UsdGeom.Boundable(root))
            for time in times
        ]
    for time, boxed, box in boxes:
        if box is not None:
            boxed.CreateExtentAttr().Set(box, time)


def _surface(stage: "Usd.Stage", skeleton: "UsdSkel.Skeleton", body: Body) -> None:
    from pxr import Gf, UsdGeom, UsdSkel, Vt

    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    mesh = UsdGeom.Mesh.Define(stage, "/Body/Surface")
    points = Vt.Vec3fArray.FromNumpy(vertices.astype("f4"))
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.reshape(-1).astype("i4")))
    # smooth by normals, not by subdivision
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(vertex_normals(vertices, faces).astype("f4")))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(0.8)]))
    joints, weights = influences(np.asarray(body.skin.bone_weights(body.skeleton.num_joints), float))
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    count = joints.shape[1]
    binding.CreateJointIndicesPrimvar(False, count).Set(
        Vt.IntArray.FromNumpy(joints.astype("i4").reshape(-1))
    )
    binding.CreateJointWeightsPrimvar(False, count).Set(Vt.FloatArray.FromNumpy(weights.reshape(-1)))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))


def _write_animation(
    stage: "Usd.Stage", skeleton: "UsdSkel.Skeleton", joints: Skeleton, motion: Motion
) -> None:
    from pxr import Gf, Sdf, UsdSkel, Vt

    animation = UsdSkel.Animation.Define(stage, skeleton.GetPath().AppendChild("Motion"))
    animation.CreateJointsAttr(skeleton.GetJointsAttr().Get())
    UsdSkel.BindingAPI(skeleton).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    animation.CreateScalesAttr(Vt.Vec3hArray(joints.num_joints, Gf.Vec3h(1)))
    places, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    moving = moving_frames(joints, motion)
    with Sdf.ChangeBlock():
        for frame, (place, turn) in enumerate(zip(*moving, strict=True)):
            places.Set(Vt.Vec3fArray.FromNumpy(place.astype("f4")), frame)
            turns.Set(Vt.QuatfArray.FromNumpy(turn.astype("f4")), frame)


def _joint_paths(skeleton: Skeleton) -> list[str]:
    """Return the path of each joint from its root, with unique and valid identifiers."""
    from pxr import Tf

    taken: set[str] = set()
    paths: list[str] = []
    for name, parent in zip(skeleton.names, skeleton.parents, strict=True):
        plain = Tf.MakeValidIdentifier(name)
        while plain in taken:
            plain += "_"
        taken.add(plain)
        paths.append(plain if parent < 0 else f"{paths[parent]}/{plain}")
    return paths
