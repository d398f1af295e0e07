"""Pose priors in files: by themselves, or in the file of the body that they are of."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..body.body import Body
from ..body.pair_prior import PairPrior, make_pair_prior, misfit
from ..body.pose_boxes import PoseBoxes, make_pose_boxes
from ..body.skeleton import Skeleton
from ..errors import InputError
from .npz import get_array, load_kind, load_limits, save_arrays, save_body

#: the format's name in a file of its own
KIND = "jaxcap prior"


def save_prior(
    path: str | Path,
    prior: PairPrior,
    boxes: PoseBoxes | None = None,
    body: Body | None = None,
    limits: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a prior, and boxes where given; with a body, into a file of the body, which `load_body`
    reads, beside what other `limits` it is to carry.

    **Raises:** `InputError` where the file cannot be written, or the prior is of another skeleton than
    the body's.
    """
    arrays = prior_arrays(prior, boxes)
    if body is None:
        save_arrays(path, KIND, arrays)
        return
    check_fit(prior, body.skeleton, path)
    save_body(path, body, {**(limits or {}), **arrays})


def load_prior(path: str | Path, skeleton: Skeleton | None = None) -> PairPrior:
    """Read a prior from a file of its own or from that of a body.

    **Raises:** `InputError` where the file holds none, is damaged or does not fit together, or where
    `skeleton` is given and the prior is of another.
    """
    arrays = _arrays(path)
    if "prior.weights" not in arrays:
        raise InputError(f"{path}: there is no pose prior in this file; learn one with `jaxcap prior learn`.")
    pairs = get_array(arrays, "prior.pairs", path, (None, 2)).tolist()
    weights = get_array(arrays, "prior.weights", path, (len(pairs), None))
    shape = weights.shape
    try:
        prior = make_pair_prior(
            tuple((above, below) for above, below in pairs),
            get_array(arrays, "prior.frames", path, (len(pairs), 2, 4)),
            weights,
            get_array(arrays, "prior.means", path, (*shape, 6)),
            get_array(arrays, "prior.factors", path, (*shape, 6, 6)),
        )
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    if skeleton is not None:
        check_fit(prior, skeleton, path)
    return prior


def load_boxes(path: str | Path, skeleton: Skeleton | None = None) -> PoseBoxes | None:
    """The boxes beside a prior; None where there are none. Errors as in `load_prior`."""
    arrays = _arrays(path)
    if "boxes.joints" not in arrays:
        return None
    joints = get_array(arrays, "boxes.joints", path, (None,)).tolist()
    lower, upper = (get_array(arrays, f"boxes.{name}", path, (len(joints), 3)) for name in ("lower", "upper"))
    lacking = [] if skeleton is None else [name for name in joints if name not in skeleton.names]
    if skeleton is not None and lacking:
        raise InputError(
            f"{path}: these boxes are of another skeleton: there is no joint '{lacking[0]}' among "
            f"{', '.join(skeleton.names)}."
        )
    try:
        return make_pose_boxes(joints, lower, upper)
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def check_fit(prior: PairPrior, skeleton: Skeleton, path: str | Path) -> None:
    """Raises `InputError` where a prior is of another skeleton."""
    reason = misfit(prior, skeleton)
    if reason is not None:
        raise InputError(f"{path}: this prior is of another skeleton: {reason}; learn one for this skeleton.")


def prior_arrays(prior: PairPrior, boxes: PoseBoxes | None = None) -> dict[str, np.ndarray]:
    """What a file says of a prior; peaks are found again when it is read."""
    arrays = {"prior.pairs": np.array(prior.pairs, dtype=str)}
    arrays |= {
        f"prior.{name}": np.asarray(getattr(prior, name))
        for name in ("frames", "weights", "means", "factors")
    }
    if boxes is not None:
        arrays["boxes.joints"] = np.array(boxes.joints, dtype=str)
        arrays |= {f"boxes.{name}": np.asarray(getattr(boxes, name)) for name in ("lower", "upper")}
    return arrays


def _arrays(path: str | Path) -> dict[str, np.ndarray]:
    arrays = load_kind(path, KIND, "jaxcap body")
    return load_limits(path) if str(arrays["format"]) == "jaxcap body" else arrays
