"""Skeletons and motions from binary glTF 2.0 (`.glb`)."""

from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from ..body.pose import Motion, Pose
from ..body.skeleton import KINDS, Skeleton, make_skeleton
from ..errors import InputError

_NUMBERS = {5121: "u1", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_HINGES = ("revolute", "universal")
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


def read_gltf(path: str | Path, rate: float | None = None) -> tuple[Skeleton, Motion | None]:
    """The joints of a file's first skin, and its first animation as their motion.

    Rest is where the inverse bind matrices have the joints; their frames there are the joints'
    orientations. Kinds and axes are those that `write_gltf` notes, else roots are free and other joints
    turn freely. Times are sampled at `rate`, the one of the keys where it is not given. Scale
    may stand above the roots alone and be the same along all axes.

    **Raises:** `InputError` where the file is not a whole one, has no skin, or has what a
    `Skeleton` and its `Pose` cannot hold: sheared, sparse or spline-keyed transforms.
    """
    path = Path(path)
    file = _File(path)
    skin = file.document.skins[0]
    nodes, joints = file.document.nodes, list(skin.joints)
    above = {child: number for number, node in enumerate(nodes) for child in node.children or []}
    parents = [joints.index(above[joint]) if above.get(joint) in joints else -1 for joint in joints]
    inverse = np.tile(np.eye(4), (len(joints), 1, 1))
    if skin.inverseBindMatrices is not None:
        inverse = file.array(skin.inverseBindMatrices).reshape(-1, 4, 4).swapaxes(1, 2)
    rest = np.linalg.inv(inverse)
    _check_rigid(path, rest[:, :3, :3])
    frames = Rotation.from_matrix(rest[:, :3, :3])
    notes = [nodes[joint].extras or {} for joint in joints]
    axes = np.tile(np.eye(3)[:2], (len(joints), 1, 1))
    for number, note in enumerate(notes):
        if np.shape(note.get("axes", ())) == (2, 3):
            axes[number] = note["axes"]
    # a hinge without its axes could turn about any
    kinds = [
        note.get("kind") if "axes" in note or note.get("kind") not in _HINGES else None for note in notes
    ]
    plain = ["free" if parent < 0 else "ball" for parent in parents]
    kinds = [kind if kind in KINDS else other for kind, other in zip(kinds, plain, strict=True)]
    names = [nodes[joint].name or f"joint{number}" for number, joint in enumerate(joints)]
    try:
        skeleton = make_skeleton(
            names, parents, kinds, rest[:, :3, 3], frames.as_quat(scalar_first=True), axes
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if not file.document.animations:
        return skeleton, None
    clock, values = file.animation(rate)
    world = _world(values, above)
    # T_j, from rest to pose, is the joint's node after the inverse of where it was bound
    bones = np.stack([world[joint] for joint in joints], 1) @ inverse
    order = [names.index(name) for name in skeleton.names]
    return skeleton, _motion(path, skeleton, bones[:, order], clock)


def _motion(path: Path, skeleton: Skeleton, bones: np.ndarray, clock: np.ndarray) -> Motion:
    """Local translations and rotations of bones `(F, J, 4, 4)` that move from rest to pose."""
    scale = np.cbrt(np.linalg.det(bones[:, 0, :3, :3]))
    bones = bones.copy()
    bones[:, :, :3] /= scale[:, None, None, None]
    _check_rigid(path, bones[:, :, :3, :3])
    centres, count = np.array(skeleton.centres, float), len(clock)
    translations, rotations = np.zeros((count, len(centres), 3)), np.zeros((count, len(centres), 4))
    for joint, parent in enumerate(skeleton.parents):
        local = bones[:, joint] if parent < 0 else np.linalg.inv(bones[:, parent]) @ bones[:, joint]
        turn = Rotation.from_matrix(local[:, :3, :3])
        rotations[:, joint] = turn.as_quat(canonical=True, scalar_first=True)
        translations[:, joint] = local[:, :3, 3] + turn.apply(centres[joint]) - centres[joint]
    dtype = skeleton.centres.dtype
    poses = Pose(*(jnp.asarray(values, dtype) for values in (translations, rotations, scale)))
    return Motion(poses, float((count - 1) / (clock[-1] - clock[0])) if count > 1 else 30.0)


def _check_rigid(path: Path, turns: np.ndarray) -> None:
    apart = np.abs(turns @ np.swapaxes(turns, -1, -2) - np.eye(3)).max()
    if apart > 1e-3 or not (np.linalg.det(turns) > 0).all():
        raise InputError(
            f"{path}: a joint is scaled, sheared or mirrored by itself; a skeleton's joints turn and slide only."
        )


def _world(values: list[dict[str, np.ndarray]], above: dict[int, int]) -> list[np.ndarray]:
    """(F, 4, 4) global transforms of every node."""
    done: dict[int, np.ndarray] = {}
    for number in range(len(values)):
        chain = [number]
        while chain[-1] in above and above[chain[-1]] not in done:
            chain.append(above[chain[-1]])
        for node in reversed(chain):
            part = values[node]
            local = np.tile(np.eye(4), (len(part["scale"]), 1, 1))
            local[:, :3, :3] = Rotation.from_quat(part["rotation"]).as_matrix() * part["scale"][:, None]
            local[:, :3, 3] = part["translation"]
            done[node] = done[above[node]] @ local if node in above else local
    return [done[number] for number in range(len(values))]


class _File:
    def __init__(self, path: Path):
        import pygltflib

        self.path = path
        if not path.is_file():
            raise InputError(f"{path}: there is no such file; check the path.")
        try:
            head = path.read_bytes()[:12]
            if head[:4] != b"glTF" or int.from_bytes(head[8:], "little") != path.stat().st_size:
                raise InputError(f"{path}: this is not a whole .glb file.")
            document: Any = pygltflib.GLTF2().load_binary(str(path))
            self.blob = document.binary_blob()
        except InputError:
            raise
        except Exception as error:  # whatever a damaged file makes of a reader
            raise InputError(f"{path}: this is not a whole .glb file ({type(error).__name__}).") from None
        if document is None or not document.skins or self.blob is None:
            raise InputError(f"{path}: there is no skin in this file; read it as a mesh.")
        self.document = document

    def array(self, index: int) -> np.ndarray:
        """The numbers of an accessor, a row an element, in float64."""
        try:
            accessor = self.document.accessors[index]
            view = self.document.bufferViews[accessor.bufferView]
            number, width = np.dtype(_NUMBERS[accessor.componentType]), _WIDTHS[accessor.type]
            if accessor.sparse is not None or view.byteStride not in (None, width * number.itemsize):
                raise InputError(f"{self.path}: sparse or interleaved numbers of joints are not read.")
            start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
            flat = np.frombuffer(self.blob, number, accessor.count * width, start).astype(float)
        except (IndexError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{self.path}: accessor {index} points outside of the file's numbers.") from None
        return flat.reshape(accessor.count, width)

    def animation(self, rate: float | None) -> tuple[np.ndarray, list[dict[str, np.ndarray]]]:
        """Times, and of every node its translation, rotation (xyzw) and scale at these."""
        animation = self.document.animations[0]
        keys = [self.array(sampler.input)[:, 0] for sampler in animation.samplers]
        clock = max(keys, key=len)
        if rate is not None:
            clock = np.arange(clock[0], clock[-1] + 0.5 / rate, 1.0 / rate)
        elif len(clock) > 1:
            clock = np.linspace(clock[0], clock[-1], len(clock))
        rest = {"translation": [0.0, 0, 0], "rotation": [0.0, 0, 0, 1], "scale": [1.0, 1, 1]}
        values = [
            {name: np.tile(getattr(node, name) or still, (len(clock), 1)) for name, still in rest.items()}
            for node in self.document.nodes
        ]
        for channel in animation.channels:
            name, sampler = channel.target.path, animation.samplers[channel.sampler]
            if name not in rest or channel.target.node is None:
                continue
            if sampler.interpolation == "CUBICSPLINE":
                raise InputError(f"{self.path}: the animation has spline keys; bake it to linear ones.")
            times, numbers = keys[channel.sampler], self.array(sampler.output)
            inside = np.clip(clock, times[0], times[-1])
            if len(times) == 1:
                found = np.tile(numbers, (len(clock), 1))
            elif sampler.interpolation == "STEP":
                found = numbers[np.searchsorted(times, inside, "right") - 1]
            elif name == "rotation":
                found = Slerp(times, Rotation.from_quat(numbers))(inside).as_quat()
            else:
                found = np.stack([np.interp(inside, times, column) for column in numbers.T], 1)
            values[channel.target.node][name] = found
        return clock, values
