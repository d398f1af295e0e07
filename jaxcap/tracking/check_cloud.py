"""Early checks that a cloud can be fitted by a body."""

import numpy as np
from jaxtyping import Float

from ..body.body import Body
from ..errors import InputError
from ..geometry.sampling import even_indices
from ..observe.clouds import Cloud
from ..units import UNIT_NAMES, UNITS, units_within

#: size of a cloud relative to its body beyond which its unit is wrong; outliers and floors extend far
MAX_RATIO, MIN_RATIO = 8.0, 0.02
#: number of points from which the size of a cloud is computed
NUM_POINTS = 1000
#: size of a cloud relative to its body within which a unit is plausible
MIN_UNIT_RATIO, MAX_UNIT_RATIO = 0.25, 1.35


def check_cloud(body: Body, cloud: Cloud, name: str = "the cloud") -> None:
    """Check that a cloud of one frame has more coordinates than the pose and about the size of the body.

    The size is the longest side of the box between the 5 % and 95 % quantiles, so that a few outliers do not
    count.

    **Raises:** `InputError` with one sentence: fewer points than the pose has parameters, or an extent that
    points to another unit, which is named. A cloud without points is refused with its own reason.
    """
    if cloud.missing:
        raise InputError(cloud.missing)
    check_cloud_extent(body, np.asarray(cloud.points, float)[np.asarray(cloud.weights) > 0], name)


def check_cloud_extent(body: Body, points: Float[np.ndarray, "N 3"], name: str) -> None:
    """Check points that are in no cloud yet as `check_cloud` does, metres."""
    dofs = body.skeleton.num_dofs
    if len(points) < dofs:
        raise InputError(
            f"{name} has {len(points)} points, fewer than the {dofs} parameters of the body's pose; "
            "give more points, or a body with fewer joints."
        )
    low, high = np.quantile(points[even_indices(len(points), NUM_POINTS)], [0.05, 0.95], axis=0)
    # a copy with contiguous coordinates, as this check is part of every tracked frame
    height = float(np.ptp(np.ascontiguousarray(np.asarray(body.vertices).T), axis=1).max())
    extent = float((high - low).max())
    if MIN_RATIO * height <= extent <= MAX_RATIO * height:
        return
    # centimetres and inches are too similar for partly visible people
    likely = units_within(extent / height, MIN_UNIT_RATIO, MAX_UNIT_RATIO)
    if not likely:
        # with a floor or a room around it
        errors = {unit: abs(np.log(extent * metres / height)) for unit, metres in UNITS.items()}
        nearest = min(errors, key=lambda unit: errors[unit])
        likely = [nearest] if errors[nearest] < np.log(4.0) else []
    if extent > height and likely:
        hint = (
            f"it looks like {' or '.join(f'{UNIT_NAMES[unit]} ({unit})' for unit in likely)}: give that unit"
        )
    else:
        hint = "check the units of both"
    raise InputError(f"{name} is {extent:.4g} m long, but the body {height:.4g} m; {hint}.")
