"""Options of `jaxcap learn` as arrays and energies: held-out meshes, pairs of joints, and further terms."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...body.body import Body
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import RigidSkin
from ...energy.energy import AbstractEnergy
from ...errors import InputError
from ...io.archives.journal import hash_file
from ...io.skinned.clip import split_clip
from ...observe.meshes import MeshSequence
from ..sources import is_human_spec
from ..terms import check_floor, read_terms


def skeleton_digest(spec: Path) -> str:
    """Return an identifier of a skeleton: the hash of its file, or the options of `human`."""
    if is_human_spec(str(spec)):
        return str(spec)
    return hash_file(split_clip(spec)[0])


def split_held_out(count: int, hold_out: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Split mesh indices into training and held-out: every `hold_out`-th is held out."""
    numbers = np.arange(count)
    held = np.zeros(count, bool) if hold_out is None else numbers % hold_out == hold_out - 1
    return numbers[~held], numbers[held]


def read_pairs(text: str, skeleton: Skeleton | None) -> np.ndarray:
    """Parse `left:right,...` to (P, 2) joints, by number or by name of a given skeleton. Raises
    `InputError`."""
    rows = []
    for word in text.split(","):
        sides = [side.strip() for side in word.split(":")]
        if len(sides) != 2 or not all(sides):
            raise InputError(f"--pairs has '{word}'; it must be left:right, such as 3:5,4:6.")
        row = []
        for side in sides:
            # names of learned joints have this prefix
            number = side.removeprefix("joint") if skeleton is None else side
            if skeleton is not None and side in skeleton.names:
                row.append(skeleton.names.index(side))
            elif number.isdigit() and (skeleton is None or int(number) < skeleton.num_joints):
                row.append(int(number))
            else:
                there = "" if skeleton is None else f"; the skeleton has {', '.join(skeleton.names)}"
                raise InputError(f"--pairs has '{side}', which is not a joint{there}.")
        if row[0] == row[1]:
            raise InputError(f"--pairs has '{word}', which pairs a joint with itself.")
        rows.append(row)
    return np.array(rows)


def learning_terms(
    meshes: MeshSequence,
    skeleton: Skeleton | None,
    *,
    limits: Path | None,
    limit_weight: float,
    floor: float | None,
    prior: Path | None,
) -> tuple[AbstractEnergy, ...]:
    """Read the energies of learning, for a body with the skeleton in the shape of the first mesh."""
    check_floor(floor, np.asarray(meshes.vertices))
    bones = make_skeleton(["root"], [-1], ["free"], np.zeros((1, 3))) if skeleton is None else skeleton
    labels = jnp.zeros(meshes.vertices.shape[1], jnp.int32)
    body = Body(bones, RigidSkin(labels), meshes.vertices[0], meshes.faces)
    return read_terms(body, limits=limits, limit_weight=limit_weight, floor=floor, prior=prior)
