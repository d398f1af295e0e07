"""Text descriptions of bodies, skeletons and motions."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from ...body.body import Body
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...body.skin import AbstractSkin, CorrectedSkin
from ...io.body_models.learned import is_own_model, read_model_people
from ...io.gltf.gltf_reader import read_shape_keys
from ...io.meshes.mesh import Mesh, read_mesh, remove_flat_faces
from ...io.registry import DEFAULT_UNITS, read_skinned
from ...io.text import shortened
from ...units import BODY_SIZE, UNITS, likely_units
from ..body_models import is_morphs_spec, load_model, split_model
from ..console.console import pluralise, say
from ..motions import extent, load_motion, warn_of_clip
from .listing import Contents, indented, print_list

#: more coefficients than any model has
MANY = 10_000
#: largest number of shape keys that a line lists
MAX_LISTED_NAMES = 8
#: longest side of a cloud of a person with the floor or the room around, metres
MAX_ROOM = 15.0


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


def describe_bvh(path: Path, unit: str | None) -> Contents:
    """Print a description of a BVH file; its contents have the unit that a verb needs, as the file has none."""
    skeleton, motion = load_motion(path, unit)
    describe_motion(motion)
    describe_skeleton(skeleton)
    if skeleton.num_joints == 1:
        return Contents("motion", unit)
    own, reach = DEFAULT_UNITS[".bvh"], extent(skeleton)
    return Contents("motion", describe_unit(reach, unit, own, "the skeleton extends over", "at rest"))


def describe_unit(
    length: float, unit: str | None, own: str, what: str, ending: str = "", longest: float = BODY_SIZE[1]
) -> str | None:
    """Print a sentence if the longest side of a person is not that of a person, and return the unit that a verb needs.

    **Arguments:** `length` metres, as read in the `unit` that was given, or else in the file's `own`; `what` and `ending`
    stand around the length in the sentence; up to the length of `longest` metres, something else may be around the person,
    and no unit is suggested.
    """
    if unit is not None or BODY_SIZE[0] <= length <= BODY_SIZE[1]:
        return unit
    likely = likely_units(length / UNITS[own], *BODY_SIZE)
    fits = (
        f"in {likely[0]} it would have the size of a person"
        if likely
        else "no usual unit gives the size of a person"
    )
    around = BODY_SIZE[1] < length <= longest
    say(
        f"unit: read in {own}, {what} {length:.3g} m{ending and ' ' + ending}; {fits}"
        f"{', unless more than a person is in it' if around else ''}"
    )
    if around:
        return None
    return likely[0] if likely else "UNIT"


def describe_motion_file(path: Path, unit: str | None) -> str:
    """Print a description of a motion with its skeleton."""
    skeleton, motion = load_motion(path, unit)
    describe_motion(motion)
    describe_skeleton(skeleton)
    return "motion"


def describe_mesh(path: Path, unit: str | None) -> Contents:
    """Print the size of a mesh or a cloud, and check if it can be the surface of a body."""
    mesh = read_mesh(path, unit or "m")
    what, size = "mesh" if len(mesh.faces) else "cloud", np.ptp(mesh.vertices, axis=0)
    normals = ", with normals" if mesh.normals is not None else ""
    say(
        f"{what}: {pluralise(len(mesh.vertices), 'vertex', 'vertices')}, {pluralise(len(mesh.faces), 'face')}, {format_size(size)}{normals}"
    )
    needed = describe_scan_unit(size, unit)
    if not len(mesh.faces):
        return Contents("cloud", needed)
    surface = remove_flat_faces(mesh)
    if not len(surface.faces):
        say("not usable as the surface of a body: no face has an area")
        return Contents("cloud", needed)
    removed = describe_removed(mesh, surface)
    if removed:
        say(f"not usable unchanged as the surface of a body: it has {removed}; `rig` leaves them out")
    return Contents("mesh", needed)


def describe_removed(mesh: Mesh, surface: Mesh) -> str:
    """Describe what `remove_flat_faces` left out of a mesh; empty if nothing."""
    faces, vertices = len(mesh.faces) - len(surface.faces), len(mesh.vertices) - len(surface.vertices)
    if not (faces or vertices):
        return ""
    return f"{pluralise(faces, 'face')} without area and {pluralise(vertices, 'vertex', 'vertices')} that no other face uses"


def describe_scan_unit(size: np.ndarray, unit: str | None) -> str | None:
    """Print a sentence if a scan of `size`, metres, has not that of a person, and return the unit that a verb needs."""
    return describe_unit(float(size.max()), unit, "m", "the longest side is", longest=MAX_ROOM)


def format_size(size: np.ndarray) -> str:
    """Format the sides of a box."""
    return " x ".join(f"{length:.3g}" for length in size) + " m"
