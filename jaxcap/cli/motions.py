"""Loading of motions and skeletons from command line arguments."""

from pathlib import Path
from typing import Any

import numpy as np

from ..body.body import Body
from ..body.pose import Motion
from ..body.skeleton import Skeleton
from ..io.registry import default_clip_message, read_motion, read_skeleton
from ..io.skeletons.amass import has_other_shape
from ..io.skeletons.body_motion import read_body_motion
from .body_models import load_shaped_body, takes_shape
from .console.console import warn
from .sources import is_human_spec, load_body


def load_motion(path: str | Path, unit: str | None = None) -> tuple[Skeleton, Motion]:
    """Load a motion with its skeleton, from any file that has both. Raises `InputError`."""
    skeleton, motion = read_motion(path, unit)
    warn_of_clip(path)
    return skeleton, motion


def load_body_motion(body: Body, path: str | Path, unit: str | None = None) -> Motion:
    """Load a motion of a body, from any file that has one. Raises `InputError` if it is of another body.

    Warns of a shape in AMASS's format, which the body may not have; `load_moving_body` applies it.
    """
    if has_other_shape(path):
        warn(f"{path}: the shape of this motion (betas) is not applied to the body")
    return _load_motion_of(body, path, unit)


def load_moving_body(spec: str, motion: str | Path, **options: Any) -> tuple[Body, Motion]:
    """Load a body with the `options` of `load_body`, and its motion in the file's own unit; a body model in the shape that the
    motion has.

    **Raises:** `InputError`.
    """
    if takes_shape(spec, motion) and options.get("vertices") is None:
        body = load_shaped_body(spec, Path(motion))
        return body, _load_motion_of(body, motion, None)
    body = load_body(spec, **options)[0]
    return body, load_body_motion(body, motion)


def _load_motion_of(body: Body, path: str | Path, unit: str | None) -> Motion:
    motion = read_body_motion(body, Path(path), unit)
    warn_of_clip(path)
    return motion


def load_skeleton(spec: str | Path, unit: str | None = None) -> Skeleton:
    """Load a skeleton: that of `human` with options, or of any file that has one. Raises `InputError`."""
    return load_body(str(spec))[0].skeleton if is_human_spec(str(spec)) else read_skeleton(spec, unit)


def extent(skeleton: Skeleton) -> float:
    """Compute the longest side of the bounding box of the rest joints, metres."""
    return float(np.ptp(np.asarray(skeleton.centres, float), axis=0).max())


def warn_of_clip(path: str | Path) -> None:
    """Print the name of the clip that is read, if a file has several and none was named."""
    sentence = default_clip_message(path)
    if sentence is not None:
        warn(sentence)
