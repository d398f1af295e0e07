"""Joint limits in files: learned surfaces as `.npz`, and limits in the formats of other programs."""

from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...arguments import checked
from ...biomechanics.anatomical_joints import JOINT_NAMES, find_anatomical_joints
from ...body.pose import Motion
from ...body.skeleton import Skeleton
from ...errors import InputError, user_message
from ...limits.abstract_limits import AbstractLimits, AllLimits
from ...limits.chart import DIMENSIONS, Chart
from ...limits.implicit_surface import LimitSurface, SurfaceLimits
from ...limits.rest_poses.anatomical_joint import AnatomicalJoint
from ...limits.rest_poses.transfer import transfer_limits
from ..kinds import wrong_kind_error
from ..skeletons.asf import read_asf
from ..skeletons.cst import read_cst
from ..system.reader_errors import reader_of
from ..text import shortened
from .npz import MIN_QUATERNION_NORM, get_array, load_format, save_arrays, skeleton_arrays, skeleton_of

#: the format's name in the file
FORMAT = "jaxcap limits"
#: arrays of a surface, with their shapes; None is any length
_ARRAY_SHAPES: dict[str, tuple[int | None, ...]] = {
    "keys": (None, 3),
    "reach": (),
    "centres": (None, None, 3),
    "thickness": (None, None),
    "unit": (),
    "level": (),
    "stiffness": (),
    "counts": (None, None),
    "densities": (None,),
}

#: numbers of a surface that files of earlier versions do not have
_FURTHER_NUMBERS = ("margin", "growth", "key_radius")


@checked
def save_limits(path: str | Path, limits: SurfaceLimits) -> None:
    """Write learned limits. Raises `InputError` if the file cannot be written."""
    arrays: dict[str, np.ndarray] = {"joints": np.array([s.joint for s in limits.surfaces], dtype=str)}
    for number, surface in enumerate(limits.surfaces):
        start = f"{number}."
        arrays |= {f"{start}{name}": np.asarray(getattr(surface, name)) for name in _ARRAY_SHAPES}
        arrays[f"{start}parent"] = np.array(surface.parent or "", dtype=str)
        arrays |= {f"{start}{name}": np.asarray(getattr(surface, name)) for name in _FURTHER_NUMBERS}
        arrays |= _chart_arrays(f"{start}chart.", surface.chart)
        arrays |= _anatomy_arrays(f"{start}anatomy.", surface.anatomy)
        arrays |= _anatomy_arrays(f"{start}parent_anatomy.", surface.parent_anatomy)
        arrays |= _rest_arrays(f"{start}rest.", surface.rest)
        arrays |= _rest_arrays(f"{start}parent_rest.", surface.parent_rest)
        if surface.parent_chart is not None:
            arrays |= _chart_arrays(f"{start}parent_chart.", surface.parent_chart)
    save_arrays(path, FORMAT, arrays)


@checked
@reader_of("joint limits")
def load_limits(path: str | Path) -> SurfaceLimits:
    """Read limits that `save_limits` wrote.

    **Raises:** `InputError` if the file has another format, is damaged, or is inconsistent.
    """
    arrays = load_format(path, FORMAT)
    joints = get_array(arrays, "joints", path, (None,), "text").tolist()
    return SurfaceLimits(tuple(_surface(arrays, f"{i}.", joint, path) for i, joint in enumerate(joints)))


@checked
@reader_of("joint limits")
def read_limits(path: str | Path, skeleton: Skeleton, motion: Motion | None = None) -> AbstractLimits:
    """Read joint limits for a skeleton from `.npz` (learned surfaces), `.cst` or `.asf`.

    Learned limits of hips, knees, ankles, shoulders, elbows and wrists are converted to other joint names and rest poses:
    see `jaxcap.limits.transfer_limits`. Other joints need the same name and rest pose.

    **Arguments:** `motion` helps to recognise a person whose rest pose is not that of a person.

    **Raises:** `InputError` if the suffix is unknown, the file is invalid, or the limits are for joints that the
    skeleton lacks, or for another rest pose of joints that are not recognised.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".npz":
        return _for_skeleton(path, load_limits(path), skeleton, motion)
    if suffix == ".cst":
        return read_cst(path, skeleton).ranges
    if suffix == ".asf":
        asf = read_asf(path)
        if asf.skeleton.names != skeleton.names:
            raise InputError(
                f"{path}: these limits belong to another skeleton with the joints {', '.join(asf.skeleton.names)}; "
                f"expected {', '.join(skeleton.names)}; give the .asf of this skeleton."
            )
        return AllLimits((asf.ranges, asf.boxes))
    raise wrong_kind_error(path, "a file of joint limits", (".npz", ".cst", ".asf"))


def _for_skeleton(
    path: Path, limits: SurfaceLimits, skeleton: Skeleton, motion: Motion | None
) -> SurfaceLimits:
    """Convert learned limits to a skeleton. Raises `InputError` where that is not possible."""
    try:
        anatomy, reason = find_anatomical_joints(skeleton, motion), ""
    except InputError as error:
        anatomy, reason = {}, f" {user_message(error)}"
    try:
        return transfer_limits(limits, skeleton, anatomy)
    except InputError as error:
        raise InputError(f"{path}: {user_message(error)}{reason}") from None


def _anatomy_arrays(prefix: str, anatomy: AnatomicalJoint | None) -> dict[str, np.ndarray]:
    if anatomy is None:
        return {}
    return {
        f"{prefix}name": np.array([anatomy.name, anatomy.joint], dtype=str),
        f"{prefix}axes": np.stack([np.asarray(anatomy.proximal), np.asarray(anatomy.distal)]),
    }


def _anatomy(arrays: Mapping[str, np.ndarray], prefix: str, path: str | Path) -> AnatomicalJoint | None:
    if f"{prefix}name" not in arrays:
        return None
    name, joint = get_array(arrays, f"{prefix}name", path, (2,), "text").tolist()
    axes = get_array(arrays, f"{prefix}axes", path, (2, 3, 3))
    # a left-handed frame would mirror all rotations
    if not (
        np.allclose(axes @ axes.transpose(0, 2, 1), np.eye(3), atol=1e-3) and (np.linalg.det(axes) > 0).all()
    ):
        raise InputError(
            f"{path}: the anatomical axes of '{shortened(joint)}' are not orthonormal and right-handed; learn the limits again."
        )
    if name not in JOINT_NAMES:
        raise InputError(
            f"{path}: the anatomical joint '{shortened(name)}' is unknown; expected one of {', '.join(JOINT_NAMES)}."
        )
    return AnatomicalJoint(name, joint, jnp.asarray(axes[0]), jnp.asarray(axes[1]))


def _rest_arrays(prefix: str, rest: Skeleton | None) -> dict[str, np.ndarray]:
    return (
        {} if rest is None else {f"{prefix}{name}": values for name, values in skeleton_arrays(rest).items()}
    )


def _rest(arrays: Mapping[str, np.ndarray], prefix: str, joint: str, path: str | Path) -> Skeleton | None:
    own = {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}
    if not own:
        return None
    rest = skeleton_of(own, path)
    if joint not in rest.names:
        raise InputError(
            f"{path}: the skeleton of the limits of '{shortened(joint)}' has no such joint; this file is damaged."
        )
    return rest


def _chart_arrays(prefix: str, chart: Chart) -> dict[str, np.ndarray]:
    return {
        f"{prefix}middle": np.asarray(chart.middle),
        f"{prefix}axes": np.asarray(chart.axes),
        f"{prefix}kind": np.array(chart.kind, dtype=str),
    }


def _chart(arrays: Mapping[str, np.ndarray], prefix: str, path: str | Path) -> Chart:
    kind = str(get_array(arrays, f"{prefix}kind", path, (), "text"))
    if kind not in DIMENSIONS:
        raise InputError(
            f"{path}: the chart '{shortened(kind)}' is unknown; expected {', '.join(DIMENSIONS)}."
        )
    middle = get_array(arrays, f"{prefix}middle", path, (4,))
    if not np.linalg.norm(middle) > MIN_QUATERNION_NORM:
        raise InputError(f"{path}: the middle of a chart is a zero quaternion; learn the limits again.")
    return Chart(jnp.asarray(middle), jnp.asarray(get_array(arrays, f"{prefix}axes", path, (2, 3))), kind)  # pyright: ignore[reportArgumentType]


def _surface(arrays: Mapping[str, np.ndarray], prefix: str, joint: str, path: str | Path) -> LimitSurface:
    values = {
        name: get_array(arrays, f"{prefix}{name}", path, shape) for name, shape in _ARRAY_SHAPES.items()
    }
    keyframes, primitives = values["centres"].shape[:2]
    alike = values["thickness"].shape == values["counts"].shape == (keyframes, primitives)
    if not (alike and keyframes and primitives and len(values["keys"]) == keyframes):
        raise InputError(
            f"{path}: the arrays of the limits of '{joint}' have inconsistent shapes; this file is damaged."
        )
    for name in ("reach", "unit", "stiffness"):
        if not values[name] > 0:
            raise InputError(
                f"{path}: the '{name}' of the limits of '{joint}' is {values[name]:g}; expected a number above 0."
            )
    further = {
        name: get_array(arrays, f"{prefix}{name}", path, ())
        for name in _FURTHER_NUMBERS
        if f"{prefix}{name}" in arrays
    }
    parent = str(get_array(arrays, f"{prefix}parent", path, (), "text")) or None
    return LimitSurface(
        joint=joint,
        parent=parent,
        chart=_chart(arrays, f"{prefix}chart.", path),
        parent_chart=None if parent is None else _chart(arrays, f"{prefix}parent_chart.", path),
        anatomy=_anatomy(arrays, f"{prefix}anatomy.", path),
        parent_anatomy=_anatomy(arrays, f"{prefix}parent_anatomy.", path),
        rest=_rest(arrays, f"{prefix}rest.", joint, path),
        parent_rest=None if parent is None else _rest(arrays, f"{prefix}parent_rest.", parent, path),
        **{name: jnp.asarray(value) for name, value in (values | further).items()},
    )
