"""`jaxcap rig`: make a body of a mesh."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro

from ..errors import InputError, user_message
from ..io.archives.npz import save_body
from ..io.meshes.mesh import Mesh, check_body_size, check_mesh, read_mesh, remove_flat_faces
from ..rigging.rig_mesh import rig_mesh
from .console.console import say
from .console.options import SKELETON_FORMATS, Flag, OptionalFile, Unit, Up, arg
from .contents.bodies import describe_removed
from .motions import load_skeleton
from .outputs import check_npz
from .sources import up_rotation, upright_skeleton


@dataclass
class Rig:
    """Place a skeleton in a mesh and bind the mesh to the bones; write a body .npz.

    Without --skeleton, the mesh has to show a person in approximately an A-pose or a T-pose. The human skeleton is
    then placed in it."""

    mesh: tyro.conf.Positional[Annotated[Path, arg(metavar="MESH")]]
    """Mesh with a closed surface: .off, .obj, .ply, .stl or .glb."""
    out: Annotated[Path, arg(aliases=("-o",), metavar="FILE")] = Path("body.npz")
    """Output file for the body, .npz."""
    skeleton: Annotated[
        OptionalFile, arg(help=f"Skeleton that is already aligned with the mesh: {SKELETON_FORMATS}.")
    ] = None
    method: Literal["automatic", "envelopes", "heat"] = "automatic"
    """Method for the skinning weights: copy them from the human model, or use heat diffusion if --skeleton is given
    (automatic); one bone per vertex (envelopes); or heat diffusion (heat)."""
    unit: Unit = "m"
    """Unit of mesh and skeleton: m, dm, cm, mm, in or ft."""
    up: Up = "y"
    """Up axis of mesh and skeleton. The body has y up."""
    overwrite: Flag = False
    """Replace the body if it exists."""

    def run(self) -> None:
        check_npz(self.out, self.overwrite, "a body")
        mesh = self.read()
        vertices = mesh.vertices @ up_rotation(self.up).T
        check_body_size(float(np.ptp(vertices, axis=0).max()), self.mesh, self.unit)
        skeleton = None
        if self.skeleton is not None:
            skeleton = upright_skeleton(load_skeleton(self.skeleton, self.unit), self.up)
        try:
            body = rig_mesh(vertices, mesh.faces, skeleton, self.method)
        except ValueError as error:
            raise InputError(f"{self.mesh}: {user_message(error)}") from None
        save_body(self.out, body)
        say(f"{self.out}: {len(body.vertices)} vertices on {body.skeleton.num_joints} joints")

    def read(self) -> Mesh:
        """Read the mesh, and leave out what is no surface, as reconstructions and scans contain it. Raises `InputError`."""
        mesh = read_mesh(self.mesh, self.unit)
        surface = remove_flat_faces(mesh)
        check_mesh(surface, self.mesh)
        removed = describe_removed(mesh, surface)
        if removed:
            say(f"left out: {removed}")
        return surface
