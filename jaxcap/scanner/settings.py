"""How bad the pictures of a simulated scanner are, and what is made of them."""

from typing import NamedTuple

import numpy as np

from ..errors import InputError


class Scanner(NamedTuple):
    """Depth cameras' errors, in the order in which they come, and how views become one scan."""

    #: share of views that are lost in a frame, each by itself; the last one left is never lost
    drop: float = 0.0
    #: a surface turned further from the camera than this is not measured, degrees
    grazing: float = 80.0
    #: share of a view's measured pixels lost in holes, and the size of holes, pixels
    holes: float = 0.0
    hole_size: float = 4.0
    #: share of pixels before a discontinuity that fly: they lie between front and back
    flying: float = 0.0
    #: how far they fly at most, metres
    flying_reach: float = 0.3
    #: deviation of a depth `z`, metres: `noise + noise_growth * z^2`
    noise: float = 0.002
    #: 1/metres
    noise_growth: float = 0.0
    #: between neighbouring depths at 1 m, metres, as of whole disparities: it grows with z^2; 0 is none
    quantise: float = 0.0
    #: neighbouring pixels further apart in depth are of different surfaces, metres
    gap: float = 0.03
    #: a normal is that of a plane through pixels so many rows and columns around
    normal_window: int = 2
    #: one point for each cube of a grid with this side, metres; 0 keeps all
    voxel: float = 0.0
    #: random points that are kept of a cloud; all where it is None
    points: int | None = None
    #: whether a scan is a mesh: the pixels of each view as a grid of triangles, cut at discontinuities,
    #: and the grids of all views beside each other, not sewn together
    mesh: bool = False


def check_scanner(scanner: Scanner) -> None:
    """That settings are in their ranges.

    **Raises:** `InputError` for the first that is not, by its name.
    """
    share, length = "from 0 and below 1", "at least 0 metres"
    wrong = {
        "drop": (0 <= scanner.drop < 1, share),
        "grazing": (0 < scanner.grazing <= 90, "above 0 and at most 90 degrees"),
        "holes": (0 <= scanner.holes < 1, share),
        "hole_size": (0 < scanner.hole_size < np.inf, "above 0 pixels"),
        "flying": (0 <= scanner.flying <= 1, "from 0 to 1"),
        "flying_reach": (0 <= scanner.flying_reach < np.inf, length),
        "noise": (0 <= scanner.noise < np.inf, length),
        "noise_growth": (0 <= scanner.noise_growth < np.inf, "at least 0 a metre"),
        "quantise": (0 <= scanner.quantise < np.inf, length),
        "gap": (0 < scanner.gap < np.inf, "above 0 metres"),
        "normal_window": (scanner.normal_window >= 1, "at least 1 pixel"),
        "voxel": (0 <= scanner.voxel < np.inf, length),
        "points": (scanner.points is None or scanner.points >= 1, "at least 1"),
    }
    for name, (fine, what) in wrong.items():
        if not fine:
            value = getattr(scanner, name)
            raise InputError(f"{name.replace('_', '-')} of the scanner is {value:g}; it must be {what}.")
    if scanner.mesh and (scanner.points is not None or scanner.voxel):
        raise InputError("A scan that is a mesh keeps its grid of pixels; leave points and voxel out.")
