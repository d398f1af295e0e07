"""Loading of bodies and clouds from command line arguments."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..body.body import Body
from ..body.decimate import reduce_body
from ..body.skeleton import Skeleton
from ..errors import InputError, user_message
from ..fit.correspondence.nearest_assignment import IndexedScan, make_mesh_scan, make_scan
from ..geometry import rotation
from ..geometry.camera import Camera
from ..io.archives.limits import read_limits
from ..io.lazy_frames import LazyFrames
from ..io.meshes.clouds import Scans
from ..io.meshes.mesh import SUFFIXES
from ..io.registry import SKINNED_READERS, is_skinned, read_body
from ..io.skinned.clip import split_clip
from ..limits.abstract_limits import AbstractLimits
from ..limits.ranges_and_cones import JointRanges
from ..observe import Scan
from ..observe.clouds import Cloud, make_cloud
from ..observe.floors_and_walls import describe_room, find_room, remove_planes
from ..observe.planes import Plane, in_room
from ..tracking.check_cloud import check_cloud_extent
from .body_models import load_model_of
from .console.console import say
from .models.human_models import is_human_spec as is_human_spec
from .models.human_models import load_human

Up = Literal["x", "y", "z", "-x", "-y", "-z"]
UPS: tuple[Up, ...] = get_args(Up)
#: description of body files in help texts and errors
BODY_FORMATS = (
    "`human` (with options, as in `human:female,height=1.7`, or `human:betas=20` for a build that is fitted), `human:anny`, a body .npz, a body model of SMPL's family (.npz or "
    ".pkl) or MHR (.pt), a skinned .glb, .gltf or USD, a .glb with shape keys as coefficients (`character.glb:morphs`), or a mesh with its .skl "
    "and .vj in the same folder"
)


def load_body(
    spec: str,
    skl: Path | None = None,
    vj: Path | None = None,
    limits: Path | None = None,
    *,
    vertices: int | None = None,
    unit: str = "m",
    up: Up = "y",
) -> tuple[Body, AbstractLimits | None]:
    """Load a body, y up, and its joint limits if their file is given.

    `spec` is `human` with options after a colon (`human:female,height=1.7,medium`), a body `.npz`, a body model of
    which the template is taken (`load_model`), a skinned `.glb`, `.gltf` or USD, or a mesh. The `.skl` and `.vj` of a mesh are read from its folder if they are not
    given. `unit` and `up` are those of mesh and skeleton files, and `up` that of `.cst` limits for them; other files
    have their own.

    **Raises:** `InputError`.
    """
    path, made, model = split_clip(spec)[0], is_human_spec(spec), load_model_of(spec, vertices)
    if model is not None:
        return model.template, None if limits is None else read_limits(limits, model.template.skeleton)
    if not made and not path.exists():
        raise InputError(f"{path}: there is no such file; give {BODY_FORMATS}.")
    # a file of these formats without a .skl has a skin of its own, or an error that `read_body` describes
    own_skin = path.suffix.lower() in SKINNED_READERS and not path.with_suffix(".skl").is_file()
    mesh = (
        not made and path.suffix.lower() in SUFFIXES and not (skl is None and (own_skin or is_skinned(path)))
    )
    if made:
        body = load_human(spec, vertices)
    elif mesh and path.is_file():
        skl = _find_companion(path, skl, ".skl")
        body = read_body(path, skl, _find_companion(path, vj, ".vj"), unit)
    else:
        body = read_body(spec)
    known = None if limits is None else read_limits(limits, body.skeleton)
    if mesh and up != "y":
        body, known = _upright(body, known, up)
    if vertices is not None:
        try:
            body = reduce_body(body, vertices)
        except ValueError as error:
            raise InputError(f"{spec}: {user_message(error)}") from None
    return body, known


def load_cloud(scans: Scans, frame: int, body: Body, up: Up = "y") -> Cloud:
    """Load one frame of a sequence, y up, and check it against the body that is to be fitted."""
    return _cloud_of(scans[frame], body, up)


def _cloud_of(scan: Scan, body: Body, up: Up) -> Cloud:
    turn = up_rotation(up)
    normals = None if scan.normals is None else scan.normals @ turn.T
    points = scan.points @ turn.T
    # checked before `make_cloud`, as the size of the body allows a better message about the unit
    check_cloud_extent(body, points, scan.name)
    return make_cloud(points, normals, name=scan.name)


class Clouds(LazyFrames[Cloud]):
    """The frames of a sequence as `load_cloud` returns them, each read on access."""

    def __init__(self, scans: Scans, body: Body, up: Up = "y"):
        super().__init__(scans.names, lambda frame: load_cloud(scans, frame, body, up))
        self._scans, self._body = scans, body
        self._up: Up = up

    def mesh(self, frame: int, planes: Sequence[Plane] = ()) -> IndexedScan:
        """Load a frame with its triangles, if it has any, without those on planes."""
        scan, turn = self._scans[frame], up_rotation(self._up)
        cloud = _cloud_of(scan, self._body, self._up)
        if scan.normals is None or not len(scan.faces):
            return make_scan(remove_planes(cloud, planes))
        points, normals = scan.points @ turn.T, scan.normals @ turn.T
        faces = scan.faces[~in_room(points, normals, planes)[scan.faces].all(1)]
        try:
            return make_mesh_scan(points, normals, faces)
        except ValueError as error:
            raise InputError(f"{scan.name}: {user_message(error)}") from None


def print_room(cloud: Cloud, keep: bool) -> tuple[Plane, ...]:
    """Find and print the floors and walls of the first cloud that are removed from all clouds; none if they are kept."""
    planes = () if keep else find_room(cloud)
    if planes:
        say(f"removed from the clouds: {describe_room(cloud, planes)}; --keep-planes keeps it")
    return planes


def up_rotation(up: Up) -> np.ndarray:
    """Compute the (3, 3) rotation of minimal angle from the vertical `up` to y."""
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    if axis[1] == -1.0:
        return np.diag([1.0, -1.0, -1.0])
    across = np.cross(axis, [0.0, 1.0, 0.0])
    cross = np.array([[0, -across[2], across[1]], [across[2], 0, -across[0]], [-across[1], across[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + axis[1])


def upright_skeleton(skeleton: Skeleton, up: Up) -> Skeleton:
    """Rotate a skeleton with the vertical `up` so that y is up."""
    turn = jnp.asarray(up_rotation(up), skeleton.centres.dtype)
    q = jnp.broadcast_to(rotation.from_matrix(turn), skeleton.orientations.shape)
    return eqx.tree_at(
        lambda s: (s.centres, s.axes, s.orientations),
        skeleton,
        (
            skeleton.centres @ turn.T,
            skeleton.axes @ turn.T,
            rotation.multiply(q, skeleton.orientations),
        ),
    )


def _find_companion(mesh: Path, explicit: Path | None, suffix: str) -> Path:
    path = mesh.with_suffix(suffix) if explicit is None else explicit
    if not path.is_file():
        raise InputError(
            f"{mesh}: a body from a mesh needs a skeleton (.skl) and the joint of each vertex (.vj), but {path} does not "
            f"exist; add this file, or rig the mesh with `jaxcap rig {mesh} -o body.npz`."
        )
    return path


def _upright(body: Body, limits: AbstractLimits | None, up: Up) -> tuple[Body, AbstractLimits | None]:
    turn = jnp.asarray(up_rotation(up), body.vertices.dtype)
    body = eqx.tree_at(
        lambda b: (b.vertices, b.skeleton),
        body,
        (body.vertices @ turn.T, upright_skeleton(body.skeleton, up)),
    )
    # ranges without boxes are those of a .cst, in the axes of the mesh; all other files have y up
    if isinstance(limits, JointRanges):
        limits = eqx.tree_at(
            lambda r: (r.heading, r.bank), limits, (limits.heading @ turn.T, limits.bank @ turn.T)
        )
    return body, limits


def upright_camera(camera: Camera, up: Up) -> Camera:
    """Rotate the world of a camera so that y is up."""
    turn = jnp.asarray(up_rotation(up), camera.rotation.dtype)
    return eqx.tree_at(lambda c: c.rotation, camera, camera.rotation @ turn.T)
