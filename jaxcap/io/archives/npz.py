"""Bodies and motions as `.npz`: plain arrays with a format name and a version, never pickled."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...body.body import Body
from ...body.pose import Motion, Pose
from ...body.skeleton import Skeleton, describe_rest_difference, make_skeleton
from ...body.skin import (
    AbstractSkin,
    CorrectedSkin,
    DualQuaternionSkin,
    LinearSkin,
    RigidSkin,
    SwingTwistSkin,
)
from ...errors import InputError, user_message
from ..kinds import KIND_NAMES, check_npz, describe_formats, wrong_arrays_error
from ..system.atomic import atomic_path
from ..system.reader_errors import reader_of
from ..text import MAX_NUMBER, RATE_RANGE, shortened
from .archive import open_archive
from .correctives import add_correctives, corrective_arrays

VERSION = 1

#: smallest norm of a quaternion that is a valid rotation
MIN_QUATERNION_NORM = 1e-6
#: largest error of the sum of a vertex's weights
WEIGHT_SUM_TOLERANCE = 1e-3
#: number of frames that a warning lists for each verdict
MAX_LISTED_FRAMES = 10
_SKELETON_ARRAYS = ("names", "parents", "kinds", "centres", "orientations", "axes")
#: prefix of the arrays of limits in a body file
LIMITS_PREFIX = "limits."
#: skins by their name in files, with their arrays
SKINS: dict[str, tuple[type[AbstractSkin], tuple[str, ...]]] = {
    "rigid": (RigidSkin, ("bones",)),
    "linear": (LinearSkin, ("weights",)),
    "dual quaternion": (DualQuaternionSkin, ("weights",)),
    "swing-twist": (SwingTwistSkin, ("bases", "swing", "twist")),
}


@checked
def save_body(path: str | Path, body: Body, limits: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a body with joint limits, which are any named arrays; read these by `load_body_limits`.

    **Raises:** `InputError` if the file cannot be written or the skin has no name in `SKINS`.
    """
    save_arrays(path, "jaxcap body", {**body_arrays(body, path), **add_limits_prefix(limits or {})})


def add_limits_prefix(limits: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Add the prefix of body files to the names of limits."""
    return {f"{LIMITS_PREFIX}{name}": values for name, values in limits.items()}


def extract_limits(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Select the limits among the arrays of a body file, and remove their prefix."""
    return {
        name.removeprefix(LIMITS_PREFIX): a for name, a in arrays.items() if name.startswith(LIMITS_PREFIX)
    }


def body_arrays(body: Body, path: str | Path) -> dict[str, Any]:
    """Convert a body to named arrays; `path` is for messages, as in `body_of`.

    Raises `InputError` for an unknown skin.
    """
    corrected = body.skin if isinstance(body.skin, CorrectedSkin) else None
    skin = body.skin if corrected is None else corrected.skin
    kind = next((name for name, (cls, _) in SKINS.items() if type(skin) is cls), None)
    if kind is None:
        raise InputError(
            f"{path}: the skin of this body is a {type(skin).__name__}, which cannot be written; use a {', '.join(SKINS)} skin."
        )
    return {
        **skeleton_arrays(body.skeleton),
        "vertices": body.vertices,
        "faces": body.faces,
        "skin": np.array(kind),
        **{f"skin.{name}": getattr(skin, name) for name in SKINS[kind][1]},
        **({} if corrected is None else corrective_arrays(corrected, path)),
    }


@checked
@reader_of("a body")
def load_body(path: str | Path) -> Body:
    """Read a body that `save_body` wrote.

    **Raises:** `InputError` if the file has another format, is damaged, or is inconsistent.
    """
    return body_of(
        load_format(path, "jaxcap body", select=lambda name: not name.startswith(LIMITS_PREFIX)), path
    )


def body_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Body:
    """Build the body from the arrays of `body_arrays`. Raises `InputError` if they are inconsistent."""
    kind = str(get_array(arrays, "skin", path, (), "text"))
    if kind not in SKINS:
        raise InputError(f"{path}: the skin '{shortened(kind)}' is unknown; expected {', '.join(SKINS)}.")
    cls, names = SKINS[kind]
    skeleton = skeleton_of(arrays, path)
    vertices = get_array(arrays, "vertices", path, (None, 3), row_name="vertex")
    faces = get_array(arrays, "faces", path, (None, 3), "whole")
    if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
        wrong = faces.max() if faces.min() >= 0 else faces.min()
        raise InputError(
            f"{path}: a face refers to vertex {wrong}, but there are only {len(vertices)} vertices."
        )
    count, joints = len(vertices), skeleton.num_joints
    fields = []
    for name in names:
        whole = name in ("bones", "bases")
        shape = (count,) if whole else (count, None)
        values = get_array(arrays, f"skin.{name}", path, shape, "whole" if whole else "numbers", "vertex")
        if not whole and values.shape[1] != joints:
            raise InputError(
                f"{path}: the skin has {values.shape[1]} bones and the skeleton {joints}; write the body again."
            )
        if whole and count and not 0 <= values.min() <= values.max() < joints:
            wrong = values.max() if values.min() >= 0 else values.min()
            raise InputError(
                f"{path}: the skin refers to bone {wrong}, but the skeleton has {joints}: 0 to {joints - 1}."
            )
        if not whole:
            _check_weights(values, path, partial=name != "weights")
        fields.append(jnp.asarray(values))
    skin = add_correctives(cls(*fields), arrays, joints, path)
    return Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(faces))


def _check_weights(weights: np.ndarray, path: str | Path, partial: bool) -> None:
    """Check that weights are at least zero and add up to one for each vertex; with `partial`, to at most one.

    The base bone takes the rest. Raises `InputError`.
    """
    if (weights < -WEIGHT_SUM_TOLERANCE).any():
        vertex, bone = divmod(int(weights.argmin()), weights.shape[1])
        raise InputError(
            f"{path}: the weight of bone {bone} for vertex {vertex} is {weights.min():g}; expected weights of at least 0 "
            "that sum to one."
        )
    excess = weights.sum(1) - 1.0
    wrong = (excess > WEIGHT_SUM_TOLERANCE) | ((excess < -WEIGHT_SUM_TOLERANCE) & (not partial))
    if wrong.any():
        vertex = int(wrong.argmax())
        raise InputError(
            f"{path}: the weights of vertex {vertex} sum to {weights[vertex].sum():g}; expected a sum of one."
        )


def load_body_limits(path: str | Path) -> dict[str, np.ndarray]:
    """Read the joint limits of a body file, by the names they were saved under; `{}` if there are none."""
    return extract_limits(
        load_format(path, "jaxcap body", select=lambda name: name.startswith(LIMITS_PREFIX))
    )


@checked
def save_motion(
    path: str | Path, motion: Motion, skeleton: Skeleton | None = None, verdicts: Sequence[str] = ()
) -> None:
    """Write a motion, with its skeleton if given.

    **Arguments:** `verdicts` of tracked frames, `good`, `doubtful` or `lost`; readers of the file are warned
    of these.

    **Raises:** `InputError` if the file cannot be written.
    """
    names = {} if skeleton is None else skeleton_arrays(skeleton)
    verdict_arrays = {"verdicts": np.array(verdicts, dtype=str)} if len(verdicts) else {}
    save_arrays(path, "jaxcap motion", {**motion_arrays(motion), **names, **verdict_arrays})


def motion_arrays(motion: Motion) -> dict[str, Any]:
    """Convert a motion to named arrays."""
    poses = motion.poses
    arrays = {"translations": poses.translations, "rotations": poses.rotations, "scale": poses.scale}
    return {**arrays, "rate": np.array(motion.rate, float)}


@checked
@reader_of("a motion")
def load_motion(path: str | Path, skeleton: Skeleton | None = None) -> Motion:
    """Read a motion that `save_motion` wrote.

    Warns of frames with the tracker's verdict doubtful or lost.

    **Raises:** `InputError` if the file has another format or is damaged; also if `skeleton` is given and has
    other joints or another rest pose (`describe_rest_difference`), for which rotations have another meaning.
    """
    arrays = load_format(path, "jaxcap motion")
    motion = motion_of(arrays, path)
    if "verdicts" in arrays:
        _warn_of_verdicts(get_array(arrays, "verdicts", path, (len(motion),), "text"), path)
    if skeleton is not None:
        own = get_array(arrays, "names", path, (None,), "text") if "names" in arrays else skeleton.names
        names, joints = tuple(str(name) for name in own), motion.poses.rotations.shape[1]
        if names != skeleton.names or joints != skeleton.num_joints:
            raise InputError(
                f"{path}: this motion has the {joints} joints {', '.join(names)}; expected "
                f"{', '.join(skeleton.names)} as in the skeleton; retarget it with `jaxcap edit retarget`."
            )
        if "parents" in arrays:
            other = describe_rest_difference(skeleton_of(arrays, path), skeleton)
            if other is not None:
                raise InputError(
                    f"{path}: this motion belongs to another rest pose: its {other}; retarget it with `jaxcap edit retarget`."
                )
    return motion


def _warn_of_verdicts(verdicts: np.ndarray, path: str | Path) -> None:
    messages = []
    for verdict in ("lost", "doubtful"):
        numbers = np.flatnonzero(verdicts == verdict)
        if len(numbers):
            named = ", ".join(map(str, numbers[:MAX_LISTED_FRAMES])) + (
                " and more" if len(numbers) > MAX_LISTED_FRAMES else ""
            )
            messages.append(
                f"{len(numbers)} of {len(verdicts)} frames are {verdict} ({named}, counted from 0)"
            )
    if messages:
        warnings.warn(
            f"{path}: in this tracked motion, {' and '.join(messages)}; see statistics.csv in its folder for the reasons.",
            stacklevel=3,
        )


def motion_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Motion:
    """Build the motion from the arrays of `motion_arrays`. Raises `InputError` if they are inconsistent."""
    rotations = get_array(arrays, "rotations", path, (None, None, 4), row_name="frame")
    frames, joints = rotations.shape[:2]
    translations = get_array(arrays, "translations", path, (frames, joints, 3), row_name="frame")
    scale = get_array(arrays, "scale", path, (frames,), row_name="frame")
    rate = get_array(arrays, "rate", path, ()).item()
    if not RATE_RANGE[0] <= rate <= RATE_RANGE[1]:
        raise InputError(
            f"{path}: the rate is {rate}; expected {RATE_RANGE[0]:g} to {RATE_RANGE[1]:g} frames per second."
        )
    if not (np.linalg.norm(rotations, axis=-1) > MIN_QUATERNION_NORM).all():
        raise InputError(f"{path}: the array 'rotations' contains zero quaternions; write unit quaternions.")
    if not (scale > 0).all():
        raise InputError(
            f"{path}: the scale is {scale.min():g} in frame {int(scale.argmin())}; expected a number above 0."
        )
    return Motion(Pose(jnp.asarray(translations), jnp.asarray(rotations), jnp.asarray(scale)), rate)


@reader_of("a skeleton")
def load_skeleton(path: str | Path) -> Skeleton:
    """Read the skeleton of a body or subject file, or of a motion file that was written with one."""
    kinds = ("jaxcap body", "jaxcap body model", "jaxcap motion", "jaxcap subject")
    return skeleton_of(load_format(path, *kinds, select=lambda name: name in _SKELETON_ARRAYS), path)


def skeleton_arrays(skeleton: Skeleton) -> dict[str, np.ndarray]:
    """Convert a skeleton to named arrays."""
    return {
        "names": np.array(skeleton.names, dtype=str),
        "parents": np.array(skeleton.parents, dtype=np.int64),
        "kinds": np.array(skeleton.kinds, dtype=str),
        "centres": np.asarray(skeleton.centres),
        "orientations": np.asarray(skeleton.orientations),
        "axes": np.asarray(skeleton.axes),
    }


def skeleton_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Skeleton:
    """Build the skeleton from the arrays of `skeleton_arrays`.

    Raises `InputError` if they are inconsistent.
    """
    names = get_array(arrays, "names", path, (None,), "text").tolist()
    count = len(names)
    parents = get_array(arrays, "parents", path, (count,), "whole").tolist()
    kinds = get_array(arrays, "kinds", path, (count,), "text").tolist()
    shapes = {"centres": (count, 3), "orientations": (count, 4), "axes": (count, 2, 3)}
    numbers = {name: get_array(arrays, name, path, shape, row_name="joint") for name, shape in shapes.items()}
    if not (np.linalg.norm(numbers["orientations"], axis=1) > MIN_QUATERNION_NORM).all():
        raise InputError(
            f"{path}: the array 'orientations' contains zero quaternions; write unit quaternions."
        )
    try:
        checked = make_skeleton(names, parents, kinds, numbers["centres"])
    except ValueError as error:
        raise InputError(f"{path}: {user_message(error)}") from None
    if checked.names != tuple(names):
        raise InputError(f"{path}: a joint comes before its parent; write the file with save_body.")
    # the arrays unchanged, so that a body is restored to the last bit
    centres, orientations, axes = (jnp.asarray(numbers[name]) for name in shapes)
    return Skeleton(checked.names, checked.parents, checked.kinds, centres, orientations, axes)


def save_arrays(path: str | Path, format_name: str, arrays: Mapping) -> None:
    """Write arrays with the name of a format, for `load_format`.

    **Raises:** `InputError` if the file cannot be written, or a value is not an array of numbers or text.
    """
    plain = {name: np.asarray(values) for name, values in arrays.items()}
    for name, values in plain.items():
        if values.dtype == object:
            raise InputError(f"{path}: '{name}' is not an array of numbers or text; give such an array.")
    with atomic_path(path) as beside, open(beside, "wb") as file:
        everything: dict[str, Any] = {"format": np.array(format_name), "version": np.array(VERSION), **plain}
        np.savez_compressed(file, **everything)


def load_format(
    path: str | Path, *formats: str, select: Callable[[str], bool] = lambda name: True
) -> dict[str, np.ndarray]:
    """Read the `select` arrays of a file of one of some formats, with its `format` and `version`.

    **Raises:** `InputError` if it has another format or version.
    """
    check_npz(path, KIND_NAMES[formats[0].removeprefix("jaxcap ")])
    with open_archive(path) as archive:
        marks = archive.load(lambda name: name in ("format", "version"))
        if str(marks.get("format", "")) not in formats:
            kinds = [name.removeprefix("jaxcap ") for name in formats]
            raise wrong_arrays_error(path, describe_formats(kinds))
        version = get_array(marks, "version", path, (), "whole").item() if "version" in marks else 0
        if version != VERSION:
            raise InputError(f"{path}: this file has version {version}; expected version {VERSION}.")
        return marks | archive.load(lambda name: name not in marks and select(name))


#: types of the contents of arrays, and their names
_CONTENT_TYPES = {
    "numbers": ("fiu", "numbers"),
    "whole": ("iu", "whole numbers"),
    "text": ("U", "text"),
}


def get_array(
    arrays: Mapping[str, np.ndarray],
    name: str,
    path: str | Path,
    shape: tuple[int | None, ...],
    content: Literal["numbers", "whole", "text"] = "numbers",
    row_name: str = "row",
) -> np.ndarray:
    """Return an array after a check of its `shape`, in which None is any length, and of its contents.

    Numbers have to be finite, and at most `MAX_NUMBER`. `row_name` names the elements of the first axis in messages.

    **Raises:** `InputError` if the array is missing or invalid.
    """
    if name not in arrays:
        raise InputError(f"{path}: the array '{name}' is missing; this file is incomplete.")
    values = arrays[name]
    fits = values.ndim == len(shape) and all(
        n is None or n == m for n, m in zip(shape, values.shape, strict=True)
    )
    if not fits:
        wanted = " x ".join("any" if n is None else str(n) for n in shape) or "a single value"
        raise InputError(f"{path}: the array '{name}' has the shape {values.shape}; expected {wanted}.")
    types, words = _CONTENT_TYPES[content]
    # an array without elements may have any type
    if values.dtype.kind not in types and values.size:
        raise InputError(f"{path}: the array '{name}' has the type {values.dtype}; expected {words}.")
    if content != "numbers":
        return values
    _check_finite(values, name, path, row_name)
    return values if values.dtype.kind == "f" else values.astype(float)


def _check_finite(values: np.ndarray, name: str, path: str | Path, row_name: str) -> None:
    """Check that an array holds finite numbers. Raises `InputError`."""
    sizes = np.abs(np.atleast_1d(values).astype(float))
    wrong = ~(sizes <= MAX_NUMBER)
    if wrong.any():
        which = f", first in {row_name} {int(np.argwhere(wrong)[0, 0])}" if values.ndim else ""
        why = "too large" if np.isfinite(sizes).all() else "not finite"
        raise InputError(f"{path}: the array '{name}' has numbers that are {why}{which}; write it again.")
