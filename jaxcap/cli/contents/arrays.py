"""Text descriptions of the contents of an `.npz`."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ...io.archives.archive import array_names, load_arrays, read_format_name
from ...io.archives.checkpoint import FORMAT as CHECKPOINT
from ...io.archives.limits import load_limits
from ...io.archives.npz import get_array, load_body, load_format, load_motion, skeleton_of
from ...io.archives.prior import has_prior, load_prior
from ...io.kinds import kind_of_arrays
from ...io.markers.subject import load_subject
from ...io.meshes.meshes import read_meshes
from ...io.skeletons.amass import describe_parameters, read_amass
from ...io.skeletons.parameters.joints import SKELETON_PREFIX
from ...io.system.reader_errors import reader_of
from ...io.text import shortened
from ...limits.implicit_surface import LimitSurface
from ..console.console import say
from .bodies import (
    describe_body,
    describe_motion,
    describe_motion_file,
    describe_scan_unit,
    describe_skeleton,
    format_size,
)
from .depth import DepthOptions, describe_camera_depth
from .folders import describe_clouds
from .listing import Contents, print_list


@reader_of("an .npz file")
def describe_arrays(path: Path, unit: str | None, options: DepthOptions) -> Contents:
    """Print a description of an `.npz`, and return its contents."""
    kind = kind_of_arrays(array_names(path), read_format_name(path))
    tell = {
        "body": _body,
        "motion": _motion,
        "amass": _amass,
        "subject": _subject,
        "limits": _limits,
        "prior": _prior,
        "checkpoint": _checkpoint,
    }
    if kind in tell:
        return Contents(tell[kind](path))
    if kind == "meshes":
        return describe_meshes(path, unit)
    if kind == "depth":
        return describe_camera_depth(path, options)
    if kind == "clouds":
        return describe_clouds(str(path), unit)
    if kind == "keys":
        keys = load_format(path, "jaxcap keys")
        say(
            f"keys: {len(get_array(keys, 'frames', path, (None,), 'whole'))} of {get_array(keys, 'count', path, (), 'whole')} frames"
        )
        describe_skeleton(skeleton_of(keys, path))
    elif kind == "joints":
        shape = load_arrays(path, lambda name: name == "joints")["joints"].shape
        say(f"joint centres: an array of shape {' x '.join(map(str, shape))}")
    else:
        _others(load_arrays(path))
    return Contents(kind)


def describe_meshes(path: Path | str, unit: str | None) -> Contents:
    """Print the number and size of registered meshes."""
    sequence = read_meshes(path, unit or "m")
    size = np.ptp(np.asarray(sequence[0]), axis=0)
    say(
        f"registered meshes: {len(sequence)} with {sequence.vertices.shape[1]} vertices and "
        f"{len(sequence.faces)} triangles; size of the first {format_size(size)}"
    )
    return Contents("meshes", describe_scan_unit(size, unit))


def _body(path: Path) -> str:
    describe_body(load_body(path))
    if has_prior(path):
        say(f"this file also contains a pose prior: {len(load_prior(path).pairs)} pairs of joints")
    return "body"


def _motion(path: Path) -> str:
    if "names" in load_format(path, "jaxcap motion"):
        return describe_motion_file(path, None)
    motion = load_motion(path)
    describe_motion(motion)
    say(f"this file contains no skeleton; the motion has {motion.poses.rotations.shape[1]} joints")
    return "motion of a body"


def _amass(path: Path) -> str:
    if f"{SKELETON_PREFIX}names" not in array_names(path):
        say(describe_parameters(path))
        return "motion of a body"
    skeleton, motion = read_amass(path)
    describe_motion(motion)
    describe_skeleton(skeleton)
    return "motion"


def _subject(path: Path) -> str:
    subject = load_subject(path)
    placed = int((np.asarray(subject.weights) > 0).sum())
    say(f"subject: {subject.num_markers} markers, {placed} of them attached to bones")
    describe_skeleton(subject.skeleton)
    return "subject"


def _limits(path: Path) -> str:
    surfaces = load_limits(path).surfaces
    print_list(map(_limit, surfaces), len(surfaces), "limits")
    return "limits"


def _limit(surface: LimitSurface) -> str:
    keyframes, primitives = surface.centres.shape[:2]
    coupled = "" if surface.parent is None else f", {keyframes} keyframes of {surface.parent}"
    return (
        f"limits of {surface.joint}: {surface.chart.dimension} angles, {primitives} primitives, smallest voxel "
        f"{np.degrees(4 * float(surface.unit)):.2g} degrees{coupled}"
    )


def _prior(path: Path) -> str:
    prior = load_prior(path)
    pairs = zip(prior.pairs, np.asarray(prior.weights), strict=True)
    lines = (
        f"prior of {parent} and {child}: {int((weights > 0).sum())} components"
        for (parent, child), weights in pairs
    )
    print_list(lines, len(prior.pairs), "pairs")
    return "prior"


def _checkpoint(path: Path) -> str:
    arrays = load_format(path, CHECKPOINT)
    steps = get_array(arrays, "history.steps", path, (None,), "text")
    vertices = get_array(arrays, "body.vertices", path, (None, 3))
    say(f"checkpoint: {len(steps)} steps are complete; the body has {len(vertices)} vertices")
    return "checkpoint"


def _others(arrays: Mapping[str, np.ndarray]) -> None:
    lines = (f"{shortened(name)}: {values.dtype} {values.shape}" for name, values in arrays.items())
    print_list(lines, len(arrays), "arrays")
