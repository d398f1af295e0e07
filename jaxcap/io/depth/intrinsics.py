"""Intrinsics of one camera as other programs write them: Open3D, RealSense and OpenCV."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from ...errors import InputError
from ...geometry.camera import Camera, check_image_size
from ..kinds import INTRINSICS_KEYS

#: rotation of a camera without extrinsics, at the origin: it looks along -z, with y up
FORWARD = np.diag([1.0, -1.0, -1.0])


def is_intrinsics(content: object) -> bool:
    """Test if the content of a JSON file is of one of these programs."""
    return isinstance(content, dict) and any(name in content for name in INTRINSICS_KEYS)


def camera_of_intrinsics(content: dict[str, Any], where: str) -> Camera:
    """Make a camera from intrinsics, at the origin if the file has no extrinsics.

    Known are `intrinsic_matrix` (Open3D, column by column), `fx, fy, ppx, ppy` (RealSense) or `fx, fy, cx, cy`, and
    `camera_matrix` (OpenCV); with `width` and `height` or `image_width` and `image_height`.

    **Raises:** `InputError` if a number is missing, or lenses distort images.
    """
    inner = content.get("intrinsic", content)
    matrix = inner.get("intrinsic_matrix", inner.get("camera_matrix"))
    if isinstance(matrix, dict):
        matrix = matrix.get("data")
    try:
        if matrix is not None:
            m = np.asarray(matrix, float).reshape(-1)
            m = m.reshape(3, 3)
            # Open3D writes columns, OpenCV rows: the last row is (0, 0, 1)
            m = m.T if abs(m[0, 2]) + abs(m[1, 2]) == 0 else m
            numbers = [m[0, 0], m[1, 1], m[0, 2], m[1, 2]]
        else:
            x, y = ("ppx", "ppy") if "ppx" in inner else ("cx", "cy")
            numbers = [float(inner[name]) for name in ("fx", "fy", x, y)]
        size = [
            int(inner[a] if a in inner else inner[b])
            for a, b in (("width", "image_width"), ("height", "image_height"))
        ]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{where}: the intrinsics of the camera are incomplete ({error}); expected focal lengths, the principal point, "
            "and the width and height of images."
        ) from None
    lens = next(
        (
            inner[name]
            for name in ("coeffs", "distortion_coefficients", "dist_coeffs", "distortion")
            if name in inner
        ),
        [],
    )
    lens = lens.get("data", []) if isinstance(lens, dict) else lens
    if np.any(np.asarray(lens, float) != 0):
        raise InputError(
            f"{where}: the lens distorts images; expected depth images without distortion: rectify them, and write zeros."
        )
    if not (np.isfinite(numbers).all() and min(numbers[:2]) > 0):
        raise InputError(f"{where}: the focal lengths are {numbers[:2]}; expected finite numbers above 0.")
    check_image_size(size[0], size[1], where)
    return Camera(
        jnp.asarray(FORWARD),
        jnp.zeros(3),
        jnp.asarray(numbers[:2]),
        jnp.asarray(numbers[2:]),
        size[0],
        size[1],
    )
