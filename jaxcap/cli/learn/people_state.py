"""The state of learning from several people as a checkpoint, and back."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...body.pose import Motion, Pose, concatenate_poses
from ...errors import InputError
from ...io.archives.checkpoint import Checkpoint, load_checkpoint
from ...io.archives.npz import get_array
from ...learn.people.learn_people import PeopleState
from ...learn.people.person import Person, repeated_rows
from ...learn.skeleton.given_centres import GivenCentres
from .state import check_unfinished

#: names of the arrays of a checkpoint
STATE_ARRAYS = (
    "pairs", "has_given_joints", "round", "counts", "vertices", "centres", "given_centres", "given_normals", "given_fixed",
    "damping", "value",
)  # fmt: skip


def make_people_checkpoint(state: PeopleState, rate: float) -> Checkpoint:
    """Convert a state to a checkpoint: the body is that of the first person, and the motion has the poses of all."""
    people = state.people
    given = [person.given for person in people]
    none = np.zeros((0, 0, 3))
    has_normals = given[0].normals is not None
    arrays = {
        "pairs": np.asarray(state.left_right_pairs, int).reshape(-1, 2),
        "has_given_joints": np.array(int(state.has_given_joints)),
        "round": np.array(state.round),
        "counts": np.array([person.num_meshes for person in people]),
        "vertices": np.stack([np.asarray(person.body.vertices) for person in people]),
        "centres": np.stack([np.asarray(person.body.skeleton.centres) for person in people]),
        "given_centres": np.stack([np.asarray(each.centres) for each in given]),
        "given_normals": np.stack([np.asarray(each.normals) for each in given]) if has_normals else none,
        "given_fixed": np.array(int(given[0].is_fixed)),
        "damping": np.array([float(person.damping) for person in people]),
        "value": np.array([float(person.value) for person in people]),
    }
    motion = Motion(concatenate_poses([person.poses for person in people]), rate)
    return Checkpoint(people[0].body, motion, tuple(state.history), arrays)


def restore_people(checkpoint: Checkpoint, path: Path) -> PeopleState:
    """Restore the state of a checkpoint by `make_people_checkpoint`, bit for bit, without the meshes; `path` is for messages.

    **Raises:** `InputError` if an array is invalid.
    """

    def read(
        name: str, shape: Sequence[int | None], content: Literal["numbers", "whole"] = "numbers"
    ) -> np.ndarray:
        return get_array(checkpoint.arrays, name, path, tuple(shape), content)

    body = checkpoint.body
    joints, dtype = body.skeleton.num_joints, body.vertices.dtype
    counts = read("counts", (None,), "whole")
    people, lengths = len(counts), [len(repeated_rows(int(count))) for count in counts]
    pairs = read("pairs", (None, 2), "whole")
    if sum(lengths) != len(checkpoint.motion) or (
        pairs.size and not 0 <= pairs.min() <= pairs.max() < joints
    ):
        raise InputError(
            f"{path}: the poses or the pairs are not those of the people; give --overwrite to begin anew."
        )
    vertices, centres = (
        jnp.asarray(read(name, (people, size, 3)), dtype)
        for name, size in (("vertices", len(body.vertices)), ("centres", joints))
    )
    where = jnp.asarray(read("given_centres", (people, joints, 3)), dtype)
    normals = read("given_normals", (None, None, 3))
    if normals.shape[:2] not in ((0, 0), (people, joints)):
        raise InputError(
            f"{path}: the given joints are not those of the body; give --overwrite to begin anew."
        )
    fixed = bool(read("given_fixed", (), "whole").item())
    damping, value = read("damping", (people,)), read("value", (people,))
    found, first = [], 0
    for number, (count, length) in enumerate(zip(counts, lengths, strict=True)):
        rows = slice(first, first + length)
        first += length
        poses: Pose = jax.tree.map(lambda leaf, rows=rows: leaf[rows], checkpoint.motion.poses)
        own = eqx.tree_at(
            lambda b: (b.vertices, b.skeleton.centres), body, (vertices[number], centres[number])
        )
        planes = jnp.asarray(normals[number], dtype) if normals.size else None
        found.append(
            Person(
                own,
                poses,
                jnp.zeros((length, 0, 3), dtype),
                GivenCentres(where[number], fixed, planes),
                damping[number].item(),
                value[number].item(),
                jnp.asarray(np.arange(length) < count, dtype),
            )
        )
    return PeopleState(
        tuple(found),
        pairs,
        bool(read("has_given_joints", (), "whole").item()),
        checkpoint.history,
        read("round", (), "whole").item(),
    )


def load_people_state(
    path: Path, header: dict[str, object], resume: bool, overwrite: bool
) -> PeopleState | None:
    """Load the state of the checkpoint `path` to resume from; None to start again.

    **Raises:** `InputError` as `check_unfinished` does, and if the checkpoint is damaged or of another run.
    """
    check_unfinished(path, resume, overwrite)
    if not resume or not path.is_file():
        return None
    return restore_people(load_checkpoint(path, header, STATE_ARRAYS), path)
