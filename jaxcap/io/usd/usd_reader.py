"""Bodies with their motions from USD (`.usd`, `.usda`, `.usdc`, `.usdz`), by OpenUSD, the extra `usd`."""

# pxr fills its modules as it is imported and has no stubs
# pyright: reportAttributeAccessIssue=false

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from ...body.body import Body
from ...body.pose import Motion
from ...errors import InputError
from ..archives.archive import MAX_EXPANSION, MIN_MEMORY_LIMIT
from ..gltf.gltf_document import missing_skin_error
from ..meshes.mesh import check_face_indices, check_points
from ..meshes.meshes import triangulate
from ..skinned.bind_pose import (
    FileJoints,
    invert_affine,
    make_bind_pose,
    make_skinned_body,
    make_skinned_motion,
    surface_to_world_transform,
)
from ..skinned.left_out import OTHER_FIGURES, SHAPE_KEYS, UNSKINNED_MESHES, warn_of_unread_content
from ..skinned.skinned_surface import SkinnedSurface, concatenate_surfaces, normalise_weights
from ..system.confined_paths import is_inside, outside_folder_error
from ..system.reader_errors import reader_of
from ..text import MAX_NUMBER, check_frame_rate
from .usd import SUFFIXES as WRITTEN
from .usd_child import check_usd
from .usd_text import check_text, parse_error
from .usd_turns import check_quaternions

if TYPE_CHECKING:
    from pxr import Usd, UsdSkel

#: suffixes that are read; `.usd` is text or binary
SUFFIXES = (".usd", *WRITTEN)


@reader_of("a USD file")
def read_usd_body(path: str | Path) -> tuple[Body, Motion | None]:
    """Read the body of a file's first skeleton, with linear blend skinning, and its animation.

    Frames are at the file's own rate. The rest pose is given by the bind transforms, in metres, y up; the
    joints' frames there are their orientations. Roots are free and other joints are ball joints, as UsdSkel
    has no joint types. Blend shapes, meshes that follow no joint and other figures are left out with a
    warning.

    **Raises:** `InputError` if usd-core is not installed, if the file is incomplete or has no skinned
    skeleton, or if it has content that a `Skeleton` and its `Pose` cannot represent: joints that are sheared
    or scaled individually.
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
            f"{path}: reading USD needs the library usd-core, which is not installed; run pip install -e '.[usd]' in a checkout of jaxcap."
        ) from None
    check_text(path)
    check_usd(path)
    try:
        _check_layers(path)
        return _Skinned(path, Usd.Stage.Open(str(path))).read()
    except Tf.ErrorException as error:
        raise parse_error(path, error) from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: this file contains text that is not UTF-8; export it again.") from None


def _check_layers(path: Path) -> None:
    """Check that every layer of a file is in its folder. Raises `InputError`."""
    from pxr import Sdf

    layers, seen = [Sdf.Layer.FindOrOpen(str(path))], set()
    while layers:
        layer = layers.pop()
        for name in layer.GetCompositionAssetDependencies() if layer else ():
            found = layer.ComputeAbsolutePath(name)
            # a layer within a package is named package.usdz[layer.usdc]
            if not is_inside(path, found.partition("[")[0]):
                raise outside_folder_error(path, name)
            if found not in seen:
                seen.add(found)
                layers.append(Sdf.Layer.FindOrOpen(found))


class _Skinned:
    """The first skeleton of a stage that moves a surface.

    Matrices act on columns, although those of USD act on rows.
    """

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
            raise missing_skin_error(path)
        self.skeleton, self.targets = bindings[0].GetSkeleton(), bindings[0].GetSkinningTargets()
        warn_of_unread_content(path, self.find_unread_content(predicate, bindings[1:]))
        self.query = cache.GetSkelQuery(self.skeleton)
        if not self.query or not len(self.query.GetJointOrder()):
            raise InputError(f"{path}: the skeleton of this file has no joints; export it again.")
        metres = float(UsdGeom.GetStageMetersPerUnit(stage))
        if not 1e-6 <= metres <= 1e6:
            raise InputError(f"{path}: metersPerUnit is {metres:g}; expected 1e-06 to 1e+06.")
        self.memory_left = max(MIN_MEMORY_LIMIT, MAX_EXPANSION * path.stat().st_size)
        # the transform of the stage to metres, y up
        self.stage_to_world = np.eye(4) * metres
        self.stage_to_world[3, 3] = 1.0
        if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z:
            self.stage_to_world = self.stage_to_world @ [
                [1, 0, 0, 0],
                [0, 0, 1, 0],
                [0, -1, 0, 0],
                [0, 0, 0, 1],
            ]

    def read(self) -> tuple[Body, Motion | None]:
        from pxr import Usd

        order = [str(joint) for joint in self.query.GetJointOrder()]
        parents = [int(parent) for parent in self.query.GetTopology().GetParentIndices()]
        names = [str(name) for name in self.skeleton.GetJointNamesAttr().Get() or ()]
        if len(set(names)) != len(order):
            names = [joint.rsplit("/", 1)[-1] for joint in order]
        if len(parents) != len(order) or -1 not in parents:
            raise InputError(
                f"{self.path}: the joints of the skeleton do not form a tree with a root; export it again."
            )
        check_quaternions(self.path, self.skeleton.GetPrim())
        if animation := self.query.GetAnimQuery():
            check_quaternions(self.path, animation.GetPrim())
        there = self.columns(self.query.GetJointWorldBindTransforms(), "bindTransforms", len(order))
        inverse = invert_affine(self.path, there)
        above, root = self.skeleton_to_world(Usd.TimeCode.Default()), parents.index(-1)
        by_root = above
        if self.query.HasRestPose():
            found = self.query.ComputeJointSkelTransforms(Usd.TimeCode.Default(), True)
            rest = self.columns(found, "restTransforms", len(order))
            by_root = above @ rest[root] @ inverse[root]
        axes = np.tile(np.eye(3)[:2], (len(order), 1, 1))
        placed = surface_to_world_transform(self.path, above[:3, :3], by_root[:3, :3])
        bound = make_bind_pose(
            self.path, FileJoints(names, parents, [None] * len(order), axes, inverse), placed
        )
        surface = concatenate_surfaces([self.surface(target, order) for target in self.targets])
        surface = surface._replace(weights=surface.weights[:, list(bound.order)])
        frames, rate = self.frames(len(order))
        motion = (
            make_skinned_motion(self.path, bound, frames[:, list(bound.order)], rate) if len(frames) else None
        )
        return make_skinned_body(self.path, bound, surface), motion

    def find_unread_content(self, predicate: "Usd.PrimFlagsPredicate", others: list) -> dict[str, list[str]]:
        """List the names of unread contents besides the first figure, by type."""
        from pxr import Usd, UsdGeom, UsdSkel

        own = {target.GetPrim().GetPath() for target in self.targets}
        theirs = {target.GetPrim().GetPath() for other in others for target in other.GetSkinningTargets()}
        meshes = [prim for prim in Usd.PrimRange.Stage(self.stage, predicate) if prim.IsA(UsdGeom.Mesh)]
        mine = [prim for prim in meshes if prim.GetPath() in own]
        return {
            OTHER_FIGURES: [other.GetSkeleton().GetPrim().GetName() for other in others],
            UNSKINNED_MESHES: [prim.GetName() for prim in meshes if prim.GetPath() not in own | theirs],
            SHAPE_KEYS: [
                prim.GetName() for prim in mine if UsdSkel.BindingAPI(prim).GetBlendShapesAttr().Get()
            ],
        }

    def skeleton_to_world(self, time: "Usd.TimeCode") -> Float[np.ndarray, "4 4"]:
        """Return the transform from the skeleton's space into the world."""
        from pxr import UsdGeom

        there = UsdGeom.XformCache(time).GetLocalToWorldTransform(self.skeleton.GetPrim())
        return self.stage_to_world @ np.array(there).T

    def frames(self, joints: int) -> tuple[Float[np.ndarray, "F J 4 4"], float]:
        """Sample the transforms of all joints into the world; return them and the frame rate."""
        from pxr import Usd

        animation = self.query.GetAnimQuery()
        times = list(animation.GetJointTransformTimeSamples()) if animation else []
        rate = check_frame_rate(float(self.stage.GetFramesPerSecond()), f"{self.path}: framesPerSecond")
        if not times:
            return np.zeros((0, 1, 4, 4)), rate
        codes = float(self.stage.GetTimeCodesPerSecond())
        step = check_frame_rate(codes, f"{self.path}: timeCodesPerSecond") / rate
        if not np.isfinite([times[0], times[-1]]).all():
            raise InputError(f"{self.path}: the times of the animation are not finite; export it again.")
        self.reserve_memory((times[-1] - times[0]) / step * joints * 3 * 16, "the animation")
        frames = []
        for code in np.arange(times[0], times[-1] + 0.5 * step, step):
            found = self.query.ComputeJointSkelTransforms(Usd.TimeCode(code))
            frames.append(
                self.skeleton_to_world(Usd.TimeCode(code))
                @ self.columns(found, f"transforms at time {code:g}", joints)
            )
        return np.stack(frames), rate

    def reserve_memory(self, numbers: float | int, purpose: str) -> None:
        """Count numbers that are computed from the file.

        Raises `InputError` if their memory exceeds the limit for its size.
        """
        self.memory_left -= 8 * numbers
        if not self.memory_left >= 0:
            raise InputError(
                f"{self.path}: {purpose} needs more memory than a file of this size may use; check its times and sizes."
            )

    def columns(self, matrices, name: str, count: int) -> Float[np.ndarray, "J 4 4"]:
        """Transpose the matrices of USD, one for each joint, to act on columns. Raises `InputError`."""
        found = np.array([] if matrices is None else matrices, float)
        if found.shape != (count, 4, 4) or not (np.abs(found) <= MAX_NUMBER).all():
            raise InputError(
                f"{self.path}: the {name} of the skeleton are invalid; expected {count} matrices of finite numbers; export it again."
            )
        return found.swapaxes(1, 2)

    def surface(self, target: "UsdSkel.SkinningQuery", order: list[str]) -> SkinnedSurface:
        from pxr import Usd, UsdGeom

        mesh, first = UsdGeom.Mesh(target.GetPrim()), Usd.TimeCode.EarliestTime()
        points = mesh.GetPointsAttr().Get(first)
        if not mesh or points is None or not len(points):
            raise InputError(
                f"{self.path}: '{target.GetPrim().GetPath()}' is not a mesh; export it as a mesh."
            )
        where = f"{self.path}: '{target.GetPrim().GetPath()}'"
        into, vertices = np.array(target.GetGeomBindTransform()).T, np.array(points, float)
        check_points(vertices, where)
        if not (np.abs(into) <= MAX_NUMBER).all():
            raise InputError(f"{where}: its geomBindTransform is not finite; export it again.")
        vertices = vertices @ into[:3, :3].T + into[:3, 3]
        self.reserve_memory(4 * len(vertices) * len(order), "its weights")
        found = target.ComputeVaryingJointInfluences(len(vertices))
        if not found or not len(found[0]):
            raise InputError(
                f"{self.path}: vertices of '{target.GetPrim().GetPath()}' have no weights; bind the whole mesh."
            )
        if len(found[0]) % len(vertices) or len(found[0]) != len(found[1]):
            raise InputError(
                f"{where}: {len(vertices)} vertices have {len(found[0])} joints and {len(found[1])} weights; expected the "
                "same number for each vertex."
            )
        chosen, shares = (np.array(values).reshape(len(vertices), -1) for values in found)
        if not ((shares >= 0) & (shares <= MAX_NUMBER)).all():
            raise InputError(f"{where}: a weight is below zero or not finite; export the mesh again.")
        place, own = {joint: number for number, joint in enumerate(order)}, target.GetJointOrder()
        named = order if own is None else [str(name) for name in own]
        strange = next((name for name in named if name not in place), None)
        if strange is not None:
            raise InputError(
                f"{where}: it refers to '{strange}', which is not a joint of the skeleton; export the mesh again."
            )
        columns = np.array([place[name] for name in named])
        if chosen.min() < 0 or chosen.max() >= len(columns):
            raise InputError(
                f"{where}: a vertex refers to joint {chosen.max()} of {len(columns)}; export the mesh again."
            )
        weights = np.zeros((len(vertices), len(order)))
        np.add.at(weights, (np.arange(len(vertices))[:, None], columns[chosen]), shares.astype(float))
        counts = np.array(mesh.GetFaceVertexCountsAttr().Get(first) or (), int)
        corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(first) or (), int)
        faces = triangulate(counts, corners, where)
        check_face_indices(faces, len(vertices), where)
        if mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded:
            faces = faces[:, ::-1]
        return SkinnedSurface(vertices, faces, normalise_weights(weights, where))
