"""Bodies with their motions from USD (`.usd`, `.usda`, `.usdc`, `.usdz`), by OpenUSD's own library, the extra `usd`."""

# pxr fills its modules as it is imported and has no stubs
# pyright: reportAttributeAccessIssue=false

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ..body.body import Body
from ..body.pose import Motion
from ..errors import InputError
from .bound import Joints, bind, body_of, motion_of, placing
from .gltf_document import no_skin
from .inside import is_inside, outside
from .meshes import triangulate
from .surface import Surface, as_shares, joined
from .usd import SUFFIXES as WRITTEN

if TYPE_CHECKING:
    from pxr import Usd, UsdSkel

#: that are read; `.usd` is as text or packed
SUFFIXES = (".usd", *WRITTEN)


def read_usd_body(path: str | Path) -> tuple[Body, Motion | None]:
    """The body of a file's first skeleton, which blends linearly, and its animation, a frame of the file's own rate each.

    Rest is where the bind transforms have the joints, in metres, y up; their frames there are the joints' orientations. Roots are
    free and other joints turn freely, as UsdSkel knows no kinds. Blend shapes are left out.

    **Raises:** `InputError` where usd-core is not installed, the file is not a whole one, has no skinned skeleton, or has what a
    `Skeleton` and its `Pose` cannot hold: joints that are sheared or scaled by themselves.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: USD is not read from '{path.suffix}' files; use {', '.join(SUFFIXES)}.")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file; check the path.")
    try:
        from pxr import Tf, Usd
    except ImportError:
        raise InputError(
            f"{path}: USD is read by the library usd-core, which is not installed; run pip install 'jaxcap[usd]'."
        ) from None
    try:
        _check_layers(path)
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        reason = str(error).strip().splitlines()[-1].strip()
        raise InputError(f"{path}: this is not a whole USD file ({reason[:200]}).") from None
    return _Skinned(path, stage).read()


def _check_layers(path: Path) -> None:
    """That every layer that a file is composed of lies in its folder. Raises `InputError`."""
    from pxr import Sdf

    layers, seen = [Sdf.Layer.FindOrOpen(str(path))], set()
    while layers:
        layer = layers.pop()
        for name in layer.GetCompositionAssetDependencies() if layer else ():
            found = layer.ComputeAbsolutePath(name)
            # a layer within a package is called package.usdz[layer.usdc]
            if not is_inside(path, found.partition("[")[0]):
                raise outside(path, name)
            if found not in seen:
                seen.add(found)
                layers.append(Sdf.Layer.FindOrOpen(found))


class _Skinned:
    """The first skeleton of a stage that moves something. Matrices are of columns, though USD has rows."""

    def __init__(self, path: Path, stage: "Usd.Stage"):
        from pxr import Usd, UsdGeom, UsdSkel

        self.path, self.stage = path, stage
        predicate, cache = Usd.TraverseInstanceProxies(), UsdSkel.Cache()
        roots = [prim for prim in Usd.PrimRange.Stage(stage, predicate) if prim.IsA(UsdSkel.Root)]
        bindings = []
        for root in map(UsdSkel.Root, roots):
            cache.Populate(root, predicate)
            bindings += [
                found
                for found in cache.ComputeSkelBindings(root, predicate)
                if len(found.GetSkinningTargets())
            ]
        if not bindings:
            raise no_skin(path)
        self.skeleton, self.targets = bindings[0].GetSkeleton(), bindings[0].GetSkinningTargets()
        self.query = cache.GetSkelQuery(self.skeleton)
        if not self.query or not len(self.query.GetJointOrder()):
            raise InputError(f"{path}: the skeleton of this file has no joints.")
        # what brings the stage into metres, y up
        self.upright = np.eye(4) * UsdGeom.GetStageMetersPerUnit(stage)
        self.upright[3, 3] = 1.0
        if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
            self.upright = self.upright @ [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]

    def read(self) -> tuple[Body, Motion | None]:
        from pxr import Usd

        order = [str(joint) for joint in self.query.GetJointOrder()]
        parents = [int(parent) for parent in self.query.GetTopology().GetParentIndices()]
        names = [str(name) for name in self.skeleton.GetJointNamesAttr().Get() or ()]
        if len(set(names)) != len(order):
            names = [joint.rsplit("/", 1)[-1] for joint in order]
        inverse = np.linalg.inv(_columns(self.query.GetJointWorldBindTransforms()))
        above, root = self.above(Usd.TimeCode.Default()), parents.index(-1)
        by_root = above
        if self.query.HasRestPose():
            rest = _columns(self.query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), True))
            by_root = above @ rest[root] @ inverse[root]
        axes = np.tile(np.eye(3)[:2], (len(order), 1, 1))
        placed = placing(self.path, above[:3, :3], by_root[:3, :3])
        bound = bind(self.path, Joints(names, parents, [None] * len(order), axes, inverse), placed)
        surface = joined([self.surface(target, order) for target in self.targets])
        surface = surface._replace(weights=surface.weights[:, list(bound.order)])
        frames, rate = self.frames()
        motion = motion_of(self.path, bound, frames[:, list(bound.order)], rate) if len(frames) else None
        return body_of(bound, surface), motion

    def above(self, time: "Usd.TimeCode") -> Float[np.ndarray, "4 4"]:
        """From the skeleton's space into the world."""
        from pxr import UsdGeom

        there = UsdGeom.XformCache(time).GetLocalToWorldTransform(self.skeleton.GetPrim())
        return self.upright @ np.array(there).T

    def frames(self) -> tuple[Float[np.ndarray, "F J 4 4"], float]:
        """Of every joint into the world, and how many there are a second."""
        from pxr import Usd

        animation = self.query.GetAnimQuery()
        times = list(animation.GetJointTransformTimeSamples()) if animation else []
        rate = float(self.stage.GetFramesPerSecond())
        if not times:
            return np.zeros((0, 1, 4, 4)), rate
        step = self.stage.GetTimeCodesPerSecond() / rate
        codes = [Usd.TimeCode(code) for code in np.arange(times[0], times[-1] + 0.5 * step, step)]
        return np.stack(
            [self.above(code) @ _columns(self.query.ComputeJointSkelTransforms(code)) for code in codes]
        ), rate

    def surface(self, target: "UsdSkel.SkinningQuery", order: list[str]) -> Surface:
        from pxr import Usd, UsdGeom

        mesh, first = UsdGeom.Mesh(target.GetPrim()), Usd.TimeCode.EarliestTime()
        points = mesh.GetPointsAttr().Get(first)
        if not mesh or points is None:
            raise InputError(f"{self.path}: '{target.GetPrim().GetPath()}' is no mesh; export it as one.")
        into = np.array(target.GetGeomBindTransform()).T
        vertices = np.array(points, float) @ into[:3, :3].T + into[:3, 3]
        found = target.ComputeVaryingJointInfluences(len(vertices))
        if not found or not len(found[0]):
            raise InputError(
                f"{self.path}: vertices of '{target.GetPrim().GetPath()}' follow no joints; bind the whole mesh."
            )
        chosen, shares = (np.array(values).reshape(len(vertices), -1) for values in found)
        own = target.GetJointOrder()
        columns = np.arange(len(order)) if own is None else np.array([order.index(str(name)) for name in own])
        if chosen.min() < 0 or chosen.max() >= len(columns):
            raise InputError(f"{self.path}: a vertex follows joint {chosen.max()} of {len(columns)}.")
        weights = np.zeros((len(vertices), len(order)))
        np.add.at(weights, (np.arange(len(vertices))[:, None], columns[chosen]), shares.astype(float))
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get(first) or (), int)
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(first) or (), int)
        faces = triangulate(counts, corners, self.path)
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            faces = faces[:, ::-1]
        where = f"{self.path}, '{target.GetPrim().GetPath()}'"
        return Surface(vertices, faces, as_shares(weights, where))


def _columns(matrices) -> Float[np.ndarray, "J 4 4"]:
    return np.array(matrices, float).swapaxes(1, 2)
