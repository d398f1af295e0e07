"""Additional energies of the fitting verbs: joint limits, a floor, and pose priors."""

from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float

from ..body.body import Body
from ..energy.data.floor import make_floor
from ..energy.energy import AbstractEnergy
from ..energy.priors.joint_limits import JointLimits
from ..energy.priors.pair_likelihood import MahalanobisPrior
from ..errors import InputError
from ..io.archives.limits import read_limits
from ..io.archives.prior import load_prior
from ..limits.abstract_limits import AbstractLimits
from ..observe.planes import Plane
from .console.console import say
from .console.options import OptionalFile, arg

LimitsFile = Annotated[
    OptionalFile,
    arg(help="Joint limits to enforce: a result of `jaxcap limits learn`, or a .cst or .asf file."),
]
LimitWeight = Annotated[
    float,
    arg(
        help="Weight of the joint limits, per squared radian beyond a limit. Default: 100, a standard deviation of 0.1 radians."
    ),
]
FloorHeight = Annotated[
    float | None,
    arg(
        metavar="METRES",
        help_behavior_hint="",
        help="Height of the floor along the up axis, metres. Vertices or markers below the floor are "
        "penalised, with a standard deviation of 10 mm. Default: for `track` and `live` the floor that the data show below the person; else none.",
    ),
]
PriorFile = Annotated[
    OptionalFile,
    arg(help="Pose prior for the skeleton: a result of `jaxcap prior learn`."),
]


def check_floor(floor: float | None, positions: Float[np.ndarray, "*N 3"]) -> None:
    """Check that a floor is not above everything that was measured, as in another unit. Raises `InputError`."""
    heights = np.asarray(positions, float)[..., 1]
    if floor is None or not np.isfinite(floor) or not np.isfinite(heights).any():
        return
    low, high = np.nanmin(heights), np.nanmax(heights)
    if floor > high:
        raise InputError(
            f"--floor is {floor:g} m, and the data are between {low:.2f} and {high:.2f} m; give the height in metres."
        )


def print_floor(floor: Plane | None) -> None:
    """Print the floor that was found in the data, if any."""
    if floor is None:
        return
    tilt = np.degrees(np.arccos(np.clip(floor.normal[1], -1.0, 1.0)))
    say(
        f"a floor was found at the height {floor.offset / floor.normal[1]:.2f} m, tilted by {tilt:.0f} degrees; feet stay above it. "
        "--floor sets another height, and --floor -100 turns this off"
    )


def read_terms(
    body: Body,
    *,
    limits: Path | AbstractLimits | None = None,
    limit_weight: float = 100.0,
    floor: float | None = None,
    prior: Path | None = None,
) -> tuple[AbstractEnergy, ...]:
    """Read the energies that the options of a verb name, in units of a log-likelihood; `limits` are joint limits
    or their file.

    **Raises:** `InputError` for an invalid weight or height, and for files that are invalid or of another
    skeleton.
    """
    if not 0 <= limit_weight < np.inf:
        raise InputError(f"--limit-weight is {limit_weight:g}; it must be at least 0.")
    if floor is not None and not np.isfinite(floor):
        raise InputError(f"--floor is {floor:g}; give its height in metres.")
    known = read_limits(limits, body.skeleton) if isinstance(limits, Path) else limits
    terms: list[AbstractEnergy] = [] if known is None else [limit_weight * JointLimits(known)]
    if floor is not None:
        terms.append(make_floor(body, floor))
    if prior is not None:
        terms.append(MahalanobisPrior(load_prior(prior, body.skeleton)))
    return tuple(terms)
