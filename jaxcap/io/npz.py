"""Bodies and motions as `.npz`: plain arrays with a format name and a version, never pickled."""

import zipfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..arguments import checked
from ..body.body import Body
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton, make_skeleton
from ..body.skin import AbstractSkin, DualQuaternionSkin, LinearSkin, RigidSkin, SwingTwistSkin
from ..errors import InputError
from .atomic import replacing
from .kinds import WORDS, check_npz, wrong_arrays

VERSION = 1

#: what the arrays beside a body are called in front
LIMITS = "limits."
#: skins by the name that a file gives them, with their arrays
SKINS: dict[str, tuple[type[AbstractSkin], tuple[str, ...]]] = {
    "rigid": (RigidSkin, ("bones",)),
    "linear": (LinearSkin, ("weights",)),
    "dual quaternion": (DualQuaternionSkin, ("weights",)),
    "swing-twist": (SwingTwistSkin, ("bases", "swing", "twist")),
}


@checked
def save_body(path: str | Path, body: Body, limits: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a body, with joint limits as any arrays by name; load them with `load_limits`.

    **Raises:** `InputError` where the file cannot be written or the skin has no name in
    `SKINS`.
    """
    save_arrays(path, "jaxcap body", {**body_arrays(body, path), **beside_body(limits or {})})


def beside_body(limits: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What a body's file says beside the body, by the names it has there."""
    return {f"{LIMITS}{name}": values for name, values in limits.items()}


def limits_in(arrays: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What `beside_body` named, by its own names."""
    return {name.removeprefix(LIMITS): a for name, a in arrays.items() if name.startswith(LIMITS)}


def body_arrays(body: Body, path: str | Path) -> dict[str, Any]:
    """What a file says of a body; `path` is for messages, as in `body_of`."""
    kind = next((name for name, (cls, _) in SKINS.items() if type(body.skin) is cls), None)
    if kind is None:
        raise InputError(
            f"{path}: a body with a {type(body.skin).__name__} cannot be written; use {', '.join(SKINS)} skins."
        )
    return {
        **skeleton_arrays(body.skeleton),
        "vertices": body.vertices,
        "faces": body.faces,
        "skin": np.array(kind),
        **{f"skin.{name}": getattr(body.skin, name) for name in SKINS[kind][1]},
    }


@checked
def load_body(path: str | Path) -> Body:
    """Read a body that `save_body` wrote.

    **Raises:** `InputError` where the file is not one, is damaged, or does not fit together.
    """
    return body_of(load_kind(path, "jaxcap body"), path)


def body_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Body:
    """The body of arrays that `body_arrays` made. Raises `InputError` where they do not fit together."""
    kind = str(arrays["skin"]) if "skin" in arrays else ""
    if kind not in SKINS:
        raise InputError(
            f"{path}: the skin '{kind}' is not known; this version reads {', '.join(SKINS)} skins."
        )
    cls, names = SKINS[kind]
    skeleton = skeleton_of(arrays, path)
    vertices, faces = (
        get_array(arrays, "vertices", path, (None, 3)),
        get_array(arrays, "faces", path, (None, 3)),
    )
    if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
        raise InputError(
            f"{path}: a face names vertex {faces.max()}, but there are {len(vertices)} vertices."
        )
    count, joints = len(vertices), skeleton.num_joints
    fields = {name: get_array(arrays, f"skin.{name}", path, (count,)) for name in names}
    for name, values in {"vertices": vertices, **{f"skin.{name}": a for name, a in fields.items()}}.items():
        _check_finite(values, name, path, "vertex")
    for name, values in fields.items():
        whole = name in ("bones", "bases")
        if whole != (values.dtype.kind in "iu") or values.shape != ((count,) if whole else (count, joints)):
            raise InputError(f"{path}: the skin is for other bones than the {joints} of the skeleton.")
        if whole and count and not 0 <= values.min() <= values.max() < joints:
            raise InputError(
                f"{path}: the skin names bone {values.max()}, but the skeleton has {joints}: 0 to {joints - 1}."
            )
    skin = cls(*(jnp.asarray(values) for values in fields.values()))
    return Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(faces))


def load_limits(path: str | Path) -> dict[str, np.ndarray]:
    """The joint limits of a body file, by the names they were saved under; none is `{}`."""
    return limits_in(load_kind(path, "jaxcap body"))


@checked
def save_motion(path: str | Path, motion: Motion, skeleton: Skeleton | None = None) -> None:
    """Write a motion; with its skeleton, the file says whose it is.

    **Raises:** `InputError` where the file cannot be written.
    """
    names = {} if skeleton is None else skeleton_arrays(skeleton)
    save_arrays(path, "jaxcap motion", {**motion_arrays(motion), **names})


def motion_arrays(motion: Motion) -> dict[str, Any]:
    """What a file says of a motion."""
    poses = motion.poses
    arrays = {"translations": poses.translations, "rotations": poses.rotations, "scale": poses.scale}
    return {**arrays, "rate": np.array(motion.rate, float)}


@checked
def load_motion(path: str | Path, skeleton: Skeleton | None = None) -> Motion:
    """Read a motion that `save_motion` wrote.

    **Raises:** `InputError` where the file is not one or is damaged, or where `skeleton` is
    given and has other joints.
    """
    arrays = load_kind(path, "jaxcap motion")
    motion = motion_of(arrays, path)
    if skeleton is not None:
        names = tuple(arrays["names"].tolist()) if "names" in arrays else skeleton.names
        joints = motion.poses.rotations.shape[1]
        if names != skeleton.names or joints != skeleton.num_joints:
            raise InputError(
                f"{path}: this motion is of the {joints} joints {', '.join(names)}, not of the skeleton's "
                f"{', '.join(skeleton.names)}; give it to that one by `jaxcap edit retarget`."
            )
    return motion


def motion_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Motion:
    """The motion of arrays that `motion_arrays` made. Raises `InputError` where they do not fit together."""
    rotations = get_array(arrays, "rotations", path, (None, None, 4))
    frames, joints = rotations.shape[:2]
    translations = get_array(arrays, "translations", path, (frames, joints, 3))
    scale, rate = get_array(arrays, "scale", path, (frames,)), get_array(arrays, "rate", path, ())
    for name, values in (("rotations", rotations), ("translations", translations), ("scale", scale)):
        _check_finite(values, name, path, "frame")
    if not np.linalg.norm(rotations, axis=-1).all():
        raise InputError(
            f"{path}: the array 'rotations' has quaternions of no length; write rotations as these."
        )
    if not (rate.dtype.kind in "fiu" and 0 < rate < np.inf):
        raise InputError(f"{path}: the rate is {rate}; it must be above 0 frames a second.")
    return Motion(Pose(jnp.asarray(translations), jnp.asarray(rotations), jnp.asarray(scale)), float(rate))


def _check_finite(values: np.ndarray, name: str, path: str | Path, what: str) -> None:
    """That an array holds finite numbers; `what` its rows are, as `frame`. Raises `InputError`."""
    if values.dtype.kind not in "fiu":
        raise InputError(f"{path}: the array '{name}' holds other than numbers; this file is not whole.")
    wrong = ~np.isfinite(values).all(tuple(range(1, values.ndim)))
    if wrong.any():
        raise InputError(
            f"{path}: the array '{name}' has numbers that are not finite, first in {what} {int(wrong.argmax())}."
        )


def load_skeleton(path: str | Path) -> Skeleton:
    """The skeleton in a body or subject file, or in a motion file that was written with one."""
    return skeleton_of(load_kind(path, "jaxcap body", "jaxcap motion", "jaxcap subject"), path)


def skeleton_arrays(skeleton: Skeleton) -> dict[str, np.ndarray]:
    """What a file says of a skeleton."""
    return {
        "names": np.array(skeleton.names, dtype=str),
        "parents": np.array(skeleton.parents, dtype=np.int64),
        "kinds": np.array(skeleton.kinds, dtype=str),
        "centres": np.asarray(skeleton.centres),
        "orientations": np.asarray(skeleton.orientations),
        "axes": np.asarray(skeleton.axes),
    }


def skeleton_of(arrays: Mapping[str, np.ndarray], path: str | Path) -> Skeleton:
    """The skeleton of arrays that `skeleton_arrays` made. Raises `InputError` where they do not fit together."""
    names = get_array(arrays, "names", path, (None,)).tolist()
    count = len(names)
    parents, kinds = (get_array(arrays, name, path, (count,)).tolist() for name in ("parents", "kinds"))
    shapes = {"centres": (count, 3), "orientations": (count, 4), "axes": (count, 2, 3)}
    numbers = {name: get_array(arrays, name, path, shape) for name, shape in shapes.items()}
    try:
        checked = make_skeleton(names, parents, kinds, numbers["centres"])
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if checked.names != tuple(names):
        raise InputError(f"{path}: a joint stands before its parent; this file was not written by save_body.")
    # the arrays as they are, so that a body comes back to the last bit
    centres, orientations, axes = (jnp.asarray(numbers[name]) for name in shapes)
    return Skeleton(checked.names, checked.parents, checked.kinds, centres, orientations, axes)


def save_arrays(path: str | Path, kind: str, arrays: Mapping) -> None:
    """Write arrays under the name of a format, for `load_kind`. Raises `InputError` where the file
    cannot be written or something is not an array of numbers or text."""
    plain = {name: np.asarray(values) for name, values in arrays.items()}
    for name, values in plain.items():
        if values.dtype == object:
            raise InputError(f"{path}: '{name}' is not an array of numbers or text; it cannot be written.")
    with replacing(path) as beside, open(beside, "wb") as file:
        everything: dict[str, Any] = {"format": np.array(kind), "version": np.array(VERSION), **plain}
        np.savez_compressed(file, **everything)


def load_arrays(path: str | Path, wanted: Callable[[str], bool] = lambda name: True) -> dict[str, np.ndarray]:
    """The arrays of any `.npz` file whose names are `wanted`, all where not given. Raises `InputError` where it is not
    one, is damaged, or holds pickled objects among these, which are never read."""
    try:
        with open(path, "rb") as raw:
            start = raw.read(6)
            if start == b"\x93NUMPY":
                raise InputError(
                    f"{path}: this is a single array, not an .npz file of named arrays; write it by numpy.savez."
                )
            if not start.startswith(b"PK"):
                raise InputError(f"{path}: this is not an .npz file; give one, whole.")
            raw.seek(0)
            with np.load(raw, allow_pickle=False) as file:
                return {name: file[name] for name in file.files if wanted(name)}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file; check the path.") from None
    except (IsADirectoryError, PermissionError) as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a readable file.") from None
    except ValueError:
        raise InputError(
            f"{path}: this file holds pickled objects, which are never read; write plain arrays."
        ) from None
    except (OSError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(f"{path}: this is not a whole .npz file ({type(error).__name__}).") from None


def load_kind(path: str | Path, *kinds: str) -> dict[str, np.ndarray]:
    """The arrays of a file of one of some formats. Raises `InputError` where it is another, or of
    another version."""
    check_npz(path, WORDS[kinds[0].removeprefix("jaxcap ")])
    arrays = load_arrays(path)
    form = str(arrays["format"]) if "format" in arrays else ""
    if form not in kinds:
        raise wrong_arrays(path, arrays, f"not a '{kinds[0]}'")
    version = int(arrays["version"]) if "version" in arrays else 0
    if version != VERSION:
        raise InputError(f"{path}: this file has version {version}; this program reads version {VERSION}.")
    return arrays


def get_array(
    arrays: Mapping[str, np.ndarray], name: str, path: str | Path, shape: tuple[int | None, ...]
) -> np.ndarray:
    """An array of which the first axes must have `shape` (None is any length)."""
    if name not in arrays:
        raise InputError(f"{path}: the array '{name}' is missing; this file is not whole.")
    values = arrays[name]
    fits = values.ndim >= len(shape) and all(
        n is None or n == m for n, m in zip(shape, values.shape, strict=False)
    )
    if not fits:
        wanted = " x ".join("any" if n is None else str(n) for n in shape)
        raise InputError(f"{path}: the array '{name}' has the shape {values.shape}; it must be {wanted}.")
    return values
