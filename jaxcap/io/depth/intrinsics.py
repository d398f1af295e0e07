"""Intrinsics of one camera as other programs write them: Open3D, RealSense and OpenCV."""

from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ...geometry.camera import Camera, check_image_size
from ...geometry.lens import NUM_COEFFICIENTS, Lens
from ..kinds import INTRINSICS_KEYS

#: rotation of a camera without extrinsics, at the origin: it looks along -z, with y up
FORWARD = np.diag([1.0, -1.0, -1.0])
#: largest error of a rotation matrix, as files round their numbers
ROTATION_TOLERANCE = 1e-4
#: names of the distortion coefficients, and of their model
COEFFICIENT_KEYS = (
    "coeffs", "distortion_coefficients", "dist_coeffs", "dist_coeff", "distortion", "dist", "D",
)  # fmt: skip
COEFFICIENT_NAMES = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
MODEL_KEYS = ("distortion_model", "model")
#: the models by their names in OpenCV, ROS and RealSense, without spaces and in lower case
LENS_MODELS: dict[str, Literal["brown_conrady", "kannala_brandt"]] = {
    **dict.fromkeys(
        ("", "plumbbob", "rationalpolynomial", "brownconrady", "modifiedbrownconrady", "pinhole"),
        "brown_conrady",
    ),
    **dict.fromkeys(("fisheye", "equidistant", "kannalabrandt", "kannalabrandt4"), "kannala_brandt"),
}
#: RealSense's models by their numbers
REALSENSE_MODELS = (
    "none", "modified_brown_conrady", "inverse_brown_conrady", "ftheta", "brown_conrady", "kannala_brandt4",
)  # fmt: skip
#: largest coefficient; those of the Azure Kinect reach 5
MAX_COEFFICIENT = 1000.0


def is_intrinsics(content: object) -> bool:
    """Test if the content of a JSON file is of one of these programs."""
    return isinstance(content, dict) and any(name in content for name in INTRINSICS_KEYS)


def camera_of_intrinsics(content: dict[str, Any], where: str) -> Camera:
    """Make a camera from intrinsics, at the origin if the file has no extrinsics.

    Known are `intrinsic_matrix` and `extrinsic` (Open3D, column by column), `fx, fy, ppx, ppy` (RealSense) or `fx, fy, cx, cy`, and
    `camera_matrix` (OpenCV); with `width` and `height` or `image_width` and `image_height`. Distortion coefficients make
    the camera's lens.

    **Raises:** `InputError` if a number is missing, or the model of the lens is unknown.
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
    if not (np.isfinite(numbers).all() and min(numbers[:2]) > 0):
        raise InputError(f"{where}: the focal lengths are {numbers[:2]}; expected finite numbers above 0.")
    check_image_size(size[0], size[1], where)
    rotation, translation = _extrinsic(content.get("extrinsic"), where)
    return Camera(
        jnp.asarray(rotation),
        jnp.asarray(translation),
        jnp.asarray(numbers[:2]),
        jnp.asarray(numbers[2:]),
        size[0],
        size[1],
        _lens(inner, where),
    )


def _extrinsic(content: object, where: str) -> tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3"]]:
    """Read the extrinsics that Open3D writes, column by column; without any, and for the identity, the camera is at the origin."""
    if content is None:
        return FORWARD, np.zeros(3)
    try:
        numbers = np.asarray(content, float)
        matrix = numbers.reshape(4, 4)
    except (TypeError, ValueError):
        raise InputError(f"{where}: 'extrinsic' is not a matrix of 4 x 4 numbers; write one.") from None
    matrix = matrix.T if numbers.ndim == 1 else matrix
    turn = matrix[:3, :3]
    if not (np.array_equal(matrix[3], [0, 0, 0, 1]) and np.isfinite(matrix).all() and is_rotation(turn)):
        raise InputError(
            f"{where}: 'extrinsic' is no rotation and translation; expected the matrix from the world to the camera, metres."
        )
    return (FORWARD, np.zeros(3)) if np.array_equal(matrix, np.eye(4)) else (turn, matrix[:3, 3])


def is_rotation(matrix: Float[np.ndarray, "3 3"]) -> bool:
    """Test if the rows of a matrix are orthonormal and right-handed, within the rounding of files."""
    error = np.abs(matrix @ matrix.T - np.eye(3)).max()
    return bool(error <= ROTATION_TOLERANCE and np.linalg.det(matrix) >= 0)


def make_lens(coefficients: object, model: str, where: str) -> Lens | None:
    """Make the lens of distortion coefficients in OpenCV's order; None if it distorts nothing.

    **Arguments:** `model`, the name of the model as OpenCV, ROS, RealSense or this library write it; empty for Brown and
    Conrady's.

    **Raises:** `InputError` for other models, and numbers that are not finite or too many.
    """
    try:
        numbers = np.asarray(coefficients, float).reshape(-1)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"{where}: the distortion coefficients are no numbers ({error}); write numbers."
        ) from None
    name = "".join(letter for letter in model.lower() if letter.isalnum()).removeprefix("distortion")
    known = LENS_MODELS.get(name)
    # a fisheye lens with zeros is the ideal one, which is no pinhole; RealSense writes zeros for images without distortion
    is_ideal = known == "kannala_brandt" and len(numbers) >= 4 and not name.endswith("4")
    if not np.any(numbers != 0) and not is_ideal:
        return None
    if name == "modifiedbrownconrady" and np.any(numbers[2:4] != 0):
        known = None
    count = 0 if known is None else NUM_COEFFICIENTS[known]
    # OpenCV's next coefficients are of thin prisms and tilted sensors
    if known is None or np.any(numbers[count:] != 0):
        raise InputError(
            f"{where}: the lens has the distortion model '{model}' with {len(numbers)} coefficients; expected Brown and "
            "Conrady's with up to 8, or Kannala and Brandt's (fisheye) with 4. Rectify the depth images, and write zeros."
        )
    if not (np.abs(numbers) <= MAX_COEFFICIENT).all():
        raise InputError(
            f"{where}: the distortion coefficients are {numbers.tolist()}; expected finite numbers of at most {MAX_COEFFICIENT:g}."
        )
    padded = np.zeros(count)
    padded[: len(numbers)] = numbers[:count]
    return Lens(jnp.asarray(padded), known)


def _lens(content: dict[str, Any], where: str) -> Lens | None:
    found = next((content[name] for name in COEFFICIENT_KEYS if name in content), content)
    if isinstance(found, dict):
        named = [float(found.get(name, 0.0)) for name in COEFFICIENT_NAMES]
        if found is not content and "data" not in found and not set(found) & set(COEFFICIENT_NAMES):
            raise InputError(
                f"{where}: the distortion has neither 'data' nor {', '.join(COEFFICIENT_NAMES)}; write the coefficients as a list."
            )
        found = found.get("data", named)
    model = next((content[name] for name in MODEL_KEYS if name in content), "")
    if isinstance(model, int):
        model = REALSENSE_MODELS[model] if 0 <= model < len(REALSENSE_MODELS) else str(model)
    if content.get("fisheye_model"):
        model = "fisheye"
    return make_lens(found, str(model), where)
