"""Morph targets (shape keys) of the mesh in a glTF file that is written."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...body.body import Body
from ...body.morph_targets import MorphTargets
from ...body.pose import Motion
from ...errors import InputError
from .glb import ARRAY_BUFFER, GlbBuilder

if TYPE_CHECKING:
    import pygltflib


def check_targets(path: Path, body: Body, motion: Motion | None, targets: MorphTargets | None) -> None:
    """Check that targets have the vertices of a body, the frames of its motion, and finite numbers. Raises `InputError`."""
    if targets is None:
        return
    count, (given, vertices) = len(targets.names), targets.displacements.shape[:2]
    frames = 0 if motion is None else motion.num_frames
    if given != count or vertices != len(body.vertices):
        raise InputError(
            f"{path}: the morph targets are {given} of {vertices} vertices, with {count} names; expected one name for each, and the "
            f"{len(body.vertices)} vertices of the body."
        )
    if targets.weights.shape != (frames, count):
        raise InputError(
            f"{path}: the weights of the morph targets have the shape {targets.weights.shape}; expected {(frames, count)} for the "
            "frames of the motion."
        )
    if not (np.isfinite(targets.displacements).all() and np.isfinite(targets.weights).all()):
        raise InputError(f"{path}: the morph targets have numbers that are not finite; correct them.")


def add_targets(blob: GlbBuilder, mesh: "pygltflib.Mesh", targets: MorphTargets) -> None:
    """Add targets to the only primitive of a mesh, with weights of zero and with their names, where most programs read them."""
    import pygltflib

    mesh.primitives[0].targets = [
        pygltflib.Attributes(POSITION=blob.add(moves.astype("<f4"), ARRAY_BUFFER, bounds=True))
        for moves in np.asarray(targets.displacements)
    ]
    mesh.weights = [0.0] * len(targets.names)
    mesh.extras = {"targetNames": list(targets.names)}
