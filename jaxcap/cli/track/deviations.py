"""Standard deviations of the coefficients and of the joints of tracked frames."""

from collections.abc import Sequence

import jax
import numpy as np
from jaxtyping import Float

from ...adapt.shape.shape_uncertainty import joint_deviations, shape_uncertainty
from ...adapt.shape.tracked_shape import NUM_FRAMES
from ...body.body_model import BodyModel
from ...body.pose import Pose
from ...errors import InputError
from ...geometry.sampling import even_indices
from ...io.lazy_frames import LazyFrames
from ...observe.clouds import Cloud
from ...observe.floors_and_walls import remove_planes
from ...observe.planes import Plane
from ...tracking.track_frame import Tracker
from ..console.console import progress
from .person_shape import SHAPE_FRAMES


def find_deviations(
    tracker: Tracker,
    model: BodyModel | None,
    clouds: LazyFrames[Cloud],
    poses: Pose,
    verdicts: Sequence[tuple[str, Sequence[str]]],
    planes: Sequence[Plane] = (),
) -> tuple[Float[np.ndarray, "K"], Float[np.ndarray, "F J"]]:
    """Compute the deviations of the coefficients, and of the joints of each frame, NaN where the body was not tracked well.

    **Arguments:** `planes`, floors and walls that are not tracked.

    **Raises:** `InputError` if none of the frames that determined the shape was tracked well, or the body is no model.
    """
    if model is None:
        raise InputError(
            "--deviations is for body models, which have coefficients; give one with --fit-shape."
        )
    good = [number for number, (verdict, _) in enumerate(verdicts) if verdict == "good"]
    some = [number for number in good if number < SHAPE_FRAMES]
    if not some:
        raise InputError(
            f"none of the first {SHAPE_FRAMES} frames has the verdict 'good', so deviations are not known; leave out --deviations."
        )

    def cloud(number: int) -> Cloud:
        return remove_planes(clouds[number], planes)

    def pose(number: int) -> Pose:
        return jax.tree.map(lambda values: values[number], poses)

    some = [some[k] for k in even_indices(len(some), NUM_FRAMES)]
    shape = shape_uncertainty(tracker, [cloud(k) for k in some], [pose(k) for k in some], model)
    joints = np.full((len(verdicts), tracker.body.skeleton.num_joints), np.nan)
    for number in progress(good, len(good), label="deviations", noun="frames"):
        joints[number] = joint_deviations(tracker, cloud(number), pose(number), shape, model)
    return np.asarray(shape.deviations, float), joints
