"""Text descriptions of bodies, skeletons and motions."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...body.skin import AbstractSkin, CorrectedSkin
from ...errors import InputError
from ...io.body_models.learned import is_own_model, read_model_people
from ...io.gltf.gltf_reader import read_shape_keys
from ...io.meshes.mesh import check_mesh, read_mesh
from ...io.registry import DEFAULT_UNITS, read_skinned
from ...io.text import shortened
from ...units import BODY_SIZE, UNITS, likely_units
from ..body_models import is_morphs_spec, load_model, split_model
from ..console.console import pluralise, say
from ..motions import extent, load_motion, warn_of_clip
from .listing import indented, print_list

#: more coefficients than any model has
MANY = 10_000
#: largest number of shape keys that a line lists
MAX_LISTED_NAMES = 8


def describe_body(body: Body) -> None:
    """Print a body's size, its skin type, and its joints."""
    size = np.ptp(np.asarray(body.vertices), axis=0)
    say(
        f"body: {len(body.vertices)} vertices, {len(body.faces)} faces, {format_size(size)}, {describe_skin(body.skin)}"
    )
    describe_skeleton(body.skeleton)


def describe_skin(skin: AbstractSkin) -> str:
    """Name the type of a skin, and the number of its displacements by the pose."""
    if not isinstance(skin, CorrectedSkin):
        return type(skin).__name__
    return f"{type(skin.skin).__name__}, {pluralise(skin.directions.shape[2], 'displacement')} by the pose"


def describe_model(spec: str) -> str:
    """Print the family and the coefficients of a body model, and its template."""
    model = load_model(spec, num_betas=MANY, num_expression=MANY, joints="full")
    if is_morphs_spec(spec):
        groups = (
            f"{pluralise(len(model.groups), 'shape key')}: {list_names(name for name, _ in model.groups)}"
        )
    else:
        groups = ", ".join(f"{size} {name}" for name, size in model.groups)
    say(f"body model: {model.family or 'of no known family'}, {groups}")
    path = split_model(spec)[0]
    people = read_model_people(path) if is_own_model(path) else {}
    if people:
        say(f"learned from {pluralise(len(people), 'person', 'people')}: {list_names(people)}")
    describe_body(model.template)
    return "body model"


def list_names(names: Iterable[str]) -> str:
    """List some names in a line, and count the others."""
    every = [shortened(name) for name in names]
    more = f" and {len(every) - MAX_LISTED_NAMES} more" if len(every) > MAX_LISTED_NAMES else ""
    return ", ".join(every[:MAX_LISTED_NAMES]) + more


def describe_skeleton(skeleton: Skeleton) -> None:
    """Print the joint tree of a skeleton."""
    kinds = [f"{skeleton.kinds.count(kind)} {kind}" for kind in dict.fromkeys(skeleton.kinds)]
    say(
        f"skeleton: {pluralise(skeleton.num_joints, 'joint')} ({', '.join(kinds)}), {skeleton.num_dofs} parameters"
    )
    print_list(_joints(skeleton), skeleton.num_joints, "joints")


def _joints(skeleton: Skeleton) -> Iterator[str]:
    for name, parent, kind, depth in zip(
        skeleton.names, skeleton.parents, skeleton.kinds, skeleton.depths, strict=True
    ):
        above = "" if parent < 0 else f" on {shortened(skeleton.names[parent])}"
        yield indented(f"{shortened(name)} ({kind}{above})", int(depth))


def describe_motion(motion: Motion) -> None:
    """Print the length of a motion."""
    count = motion.num_frames
    say(
        f"motion: {pluralise(count, 'frame')} at {motion.rate:g} frames per second, {count / motion.rate:.2f} s"
    )


def describe_skinned(path: Path) -> str:
    """Print a description of a skinned `.glb`, `.gltf` or USD."""
    body, motion = read_skinned(path)
    warn_of_clip(path)
    if motion is not None:
        describe_motion(motion)
    describe_body(body)
    if path.suffix.lower() in (".glb", ".gltf") and (keys := read_shape_keys(path)):
        say(
            f"{pluralise(len(keys), 'shape key')}: {list_names(keys)}; they are the coefficients of the body {path}:morphs, for "
            "`jaxcap fit`, `adapt` and `track --fit-shape`"
        )
    return "skinned" if motion is None else "animated"


def describe_bvh(path: Path, unit: str | None) -> tuple[str, str | None]:
    """Print a description of a BVH file; return its kind and the unit that a verb needs, as the file has
    none."""
    skeleton, motion = load_motion(path, unit)
    describe_motion(motion)
    describe_skeleton(skeleton)
    reach = extent(skeleton)
    if unit is not None or BODY_SIZE[0] <= reach <= BODY_SIZE[1] or skeleton.num_joints == 1:
        return "motion", unit
    own = DEFAULT_UNITS[".bvh"]
    likely = likely_units(reach / UNITS[own], *BODY_SIZE)
    fits = (
        f"in {likely[0]} it would have the size of a person"
        if likely
        else "no usual unit gives the size of a person"
    )
    say(f"unit: read in {own}, the skeleton extends over {reach:.3g} m at rest; {fits}")
    return "motion", likely[0] if likely else "UNIT"


def describe_motion_file(path: Path, unit: str | None) -> str:
    """Print a description of a motion with its skeleton."""
    skeleton, motion = load_motion(path, unit)
    describe_motion(motion)
    describe_skeleton(skeleton)
    return "motion"


def describe_mesh(path: Path, unit: str) -> str:
    """Print the size of a mesh or a cloud, and check if it can be the surface of a body."""
    mesh = read_mesh(path, unit)
    what = "mesh" if len(mesh.faces) else "cloud"
    normals = ", with normals" if mesh.normals is not None else ""
    say(
        f"{what}: {pluralise(len(mesh.vertices), 'vertex', 'vertices')}, {pluralise(len(mesh.faces), 'face')}, {format_size(np.ptp(mesh.vertices, axis=0))}{normals}"
    )
    if not len(mesh.faces):
        return "cloud"
    try:
        check_mesh(mesh, path)
    except InputError as error:
        say(f"not usable as the surface of a body: {error}")
        return "cloud"
    return "mesh"


def format_size(size: np.ndarray) -> str:
    """Format the sides of a box."""
    return " x ".join(f"{length:.3g}" for length in size) + " m"
