"""Standard deviations of the coefficients and of the joints of fitted frames."""

from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Float

from ...adapt.shape.shape_uncertainty import joint_deviations, shape_uncertainty
from ...adapt.shape.tracked_shape import NUM_FRAMES
from ...body.body_model import BodyModel
from ...body.pose import Pose
from ...errors import InputError
from ...geometry.sampling import even_indices
from ...observe.clouds import Cloud
from ...observe.floors_and_walls import remove_planes
from ...observe.planes import Plane
from ...tracking.track_frame import Tracker
from ..console.console import progress
from .person_shape import SHAPE_FRAMES

#: those of the coefficients, and of the joints of each frame, metres
Deviations = tuple[Float[np.ndarray, "*frames K"], Float[np.ndarray, "F J"]]


def find_deviations(
    tracker: Tracker,
    model: BodyModel | None,
    cloud: Callable[[int], Cloud],
    poses: Pose,
    good: Sequence[int],
    of_shape: Sequence[int] | None = None,
) -> Deviations:
    """Compute the deviations of the coefficients, and of the joints of each frame, NaN where the body was not fitted well.

    **Arguments:** `cloud`, the points of a frame that were fitted; `good`, the frames that were fitted well; `of_shape`, those of them
    that determined the shape, those of the first frames where not given.

    **Raises:** `InputError` if no frame that determined the shape was fitted well, or the body is no model.
    """
    if model is None:
        raise InputError("--deviations is for body models, which have coefficients; give one as BODY.")
    of_shape = [number for number in good if number < SHAPE_FRAMES] if of_shape is None else of_shape
    if not of_shape:
        raise InputError(
            "none of the frames that determine the shape has the verdict 'good', so deviations are not known; leave out --deviations."
        )

    def pose(number: int) -> Pose:
        return jax.tree.map(lambda values: values[number], poses)

    some = [of_shape[k] for k in even_indices(len(of_shape), NUM_FRAMES)]
    shape = shape_uncertainty(tracker, [cloud(k) for k in some], [pose(k) for k in some], model)
    joints = np.full((len(poses.scale), tracker.body.skeleton.num_joints), np.nan)
    for number in progress(good, len(good), label="deviations", noun="frames"):
        joints[number] = joint_deviations(tracker, cloud(number), pose(number), shape, model)
    return np.asarray(shape.deviations, float), joints


def good_frames(verdicts: Sequence[tuple[str, Sequence[str]]]) -> list[int]:
    """List the frames with the verdict `good`."""
    return [number for number, (verdict, _) in enumerate(verdicts) if verdict == "good"]


def own_cloud(clouds: Sequence[Cloud], planes: Sequence[Plane], number: int) -> Cloud:
    """Return the cloud of a frame without floors and walls."""
    return remove_planes(clouds[number], planes)
