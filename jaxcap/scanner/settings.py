"""Settings of a simulated scanner: errors of depth images, and their fusion."""

from typing import NamedTuple

import numpy as np

from ..errors import InputError


class Scanner(NamedTuple):
    """The errors of depth cameras, in their order of application, and the fusion of views in one scan."""

    #: probability of the loss of a view in a frame, independent of the others; at least one view is kept
    drop: float = 0.0
    #: least and largest measured depth, metres
    min_range: float = 0.0
    max_range: float = np.inf
    #: distance of the projector or second eye on the right of the camera, metres: surface that it does not see is lost; 0 is none
    baseline: float = 0.0
    #: largest measurable angle between surface normal and ray, degrees
    max_grazing_angle: float = 80.0
    #: share of the pixels at a discontinuity that are lost
    edge_loss: float = 0.0
    #: share of a view's measured pixels lost in holes, and the size of holes, pixels
    holes: float = 0.0
    hole_size: float = 4.0
    #: share of flying pixels, between front and back, among the pixels in front of a discontinuity
    flying: float = 0.0
    #: largest shift of a flying pixel, metres
    flying_reach: float = 0.3
    #: standard deviation of a depth `z` is `noise + noise_growth * (z - noise_from)^2`, metres
    noise: float = 0.002
    #: 1/metres
    noise_growth: float = 0.0
    #: metres
    noise_from: float = 0.0
    #: further deviation `noise_angle / sqrt(z) * (a / (pi/2 - a))^2` for the angle `a` between normal and ray; metres^1.5
    noise_angle: float = 0.0
    #: step between depths at 1 m by whole disparities, metres; it grows with z^2; 0 is none
    depth_step: float = 0.0
    #: unit of depths, metres, to whose multiples they are rounded at last; 0 is none
    depth_unit: float = 0.0
    #: largest difference in depth of neighbouring pixels on one surface, metres
    gap: float = 0.03
    #: number of rows and columns around a pixel for its normal
    normal_window: int = 2
    #: one point for each cube of a grid with this side, metres; 0 keeps all
    voxel: float = 0.0
    #: number of points kept of a cloud, at random; None keeps all
    points: int | None = None
    #: share of points replaced by outliers, uniform in the box of the surface and 0.1 m around it
    outliers: float = 0.0
    #: make meshes: a grid of triangles for each view, cut at discontinuities; grids of views are not merged
    mesh: bool = False


def check_scanner(scanner: Scanner) -> None:
    """Check that settings are in their ranges.

    **Raises:** `InputError` that names the first setting that is not.
    """
    share, length = "at least 0 and below 1", "at least 0 metres"
    wrong = {
        "drop": (0 <= scanner.drop < 1, share),
        "min_range": (0 <= scanner.min_range < np.inf, length),
        "max_range": (scanner.max_range > scanner.min_range, "above the least range"),
        "baseline": (0 <= scanner.baseline < np.inf, length),
        "edge_loss": (0 <= scanner.edge_loss <= 1, "from 0 to 1"),
        "max_grazing_angle": (0 < scanner.max_grazing_angle <= 90, "above 0 and at most 90 degrees"),
        "holes": (0 <= scanner.holes < 1, share),
        "hole_size": (0 < scanner.hole_size < np.inf, "above 0 pixels"),
        "flying": (0 <= scanner.flying <= 1, "from 0 to 1"),
        "flying_reach": (0 <= scanner.flying_reach < np.inf, length),
        "noise": (0 <= scanner.noise < np.inf, length),
        "noise_growth": (0 <= scanner.noise_growth < np.inf, "at least 0 per metre"),
        "noise_from": (0 <= scanner.noise_from < np.inf, length),
        "noise_angle": (0 <= scanner.noise_angle < np.inf, "at least 0"),
        "depth_unit": (0 <= scanner.depth_unit < np.inf, length),
        "depth_step": (0 <= scanner.depth_step < np.inf, length),
        "gap": (0 < scanner.gap < np.inf, "above 0 metres"),
        "normal_window": (scanner.normal_window >= 1, "at least 1 pixel"),
        "voxel": (0 <= scanner.voxel < np.inf, length),
        "outliers": (0 <= scanner.outliers < 1, share),
        "points": (scanner.points is None or scanner.points >= 1, "at least 1"),
    }
    for name, (fine, what) in wrong.items():
        if not fine:
            value = getattr(scanner, name)
            raise InputError(f"{name.replace('_', '-')} of the scanner is {value:g}; it must be {what}.")
    if scanner.mesh and (scanner.points is not None or scanner.voxel or scanner.outliers):
        raise InputError(
            "A scan as a mesh keeps all pixels of the grid; remove the settings points, voxel and outliers."
        )
