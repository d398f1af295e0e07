"""Intrinsics of one camera as other programs write them: Open3D, RealSense and OpenCV."""

from collections.abc import Sequence
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ...errors import InputError
from ...geometry.camera import Camera, check_image_size
from ...geometry.lens import NUM_COEFFICIENTS, Lens
from .camera_keys import MATRIX_KEYS, SIZE_KEYS, SIZE_LIST_KEYS, incomplete_error

#: rotation of a camera without extrinsics, at the origin: it looks along -z, with y up
FORWARD = np.diag([1.0, -1.0, -1.0])
#: largest error of a rotation matrix, as files round their numbers
ROTATION_TOLERANCE = 1e-4
#: names of the distortion coefficients, and of their model
COEFFICIENT_KEYS = (
    "coeffs", "distortion_coefficients", "dist_coeffs", "dist_coeff", "distortion", "dist", "D", "distCoeffs",
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


def cameras_of_intrinsics(contents: Sequence[dict[str, Any]], where: str) -> list[Camera]:
    """Make cameras from intrinsics; a single one without extrinsics is at the origin.

    Known are `intrinsic_matrix` and `extrinsic` (Open3D, column by column), `fx, fy, ppx, ppy` (RealSense) or `fx, fy, cx, cy`, and
    `camera_matrix`, `cameraMatrix`, `K` or `mtx` (OpenCV, row by row); with `width` and `height`, `image_width` and
    `image_height`, or `image_size`. Distortion coefficients make the camera's lens. If the extrinsics of a camera are the
    identity, its world has y down, and is turned to y up for all cameras.

    **Raises:** `InputError` if a number is missing, or the model of the lens is unknown; also if one of several cameras has
    no extrinsics.
    """
    several = len(contents) > 1
    names = [f"{where}: camera {number}" if several else where for number in range(len(contents))]
    matrices = []
    for name, content in zip(names, contents, strict=True):
        if several and content.get("extrinsic") is None:
            raise InputError(
                f"{name} has no 'extrinsic'; write the matrix from the world to each of the {len(contents)} cameras."
            )
        matrices.append(_extrinsic(content.get("extrinsic"), name))
    turn = FORWARD if any(np.array_equal(matrix, np.eye(4)) for matrix in matrices) else np.eye(3)
    return [
        _camera(content, matrix[:3, :3] @ turn, matrix[:3, 3], name)
        for content, matrix, name in zip(contents, matrices, names, strict=True)
    ]


def _camera(
    content: dict[str, Any],
    rotation: Float[np.ndarray, "3 3"],
    translation: Float[np.ndarray, "3"],
    where: str,
) -> Camera:
    inner = content.get("intrinsic", content)
    if not isinstance(inner, dict):
        raise incomplete_error(where, "'intrinsic' is not an object with keys")
    matrix = next((inner[name] for name in MATRIX_KEYS if name in inner), None)
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
        both = next((inner[name] for name in SIZE_LIST_KEYS if name in inner), None)
        given = [inner[a] if a in inner else inner[b] for a, b in SIZE_KEYS] if both is None else both
        width, height = map(int, given)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        found = f"{error} is missing" if isinstance(error, KeyError) else str(error)
        raise incomplete_error(where, f"the intrinsics of the camera are incomplete ({found})") from None
    if not (np.isfinite(numbers).all() and min(numbers[:2]) > 0):
        raise InputError(f"{where}: the focal lengths are {numbers[:2]}; expected finite numbers above 0.")
    check_image_size(width, height, where)
    return Camera(
        jnp.asarray(rotation),
        jnp.asarray(translation),
        jnp.asarray(numbers[:2]),
        jnp.asarray(numbers[2:]),
        width,
        height,
        _lens(inner, where),
    )


def _extrinsic(content: object, where: str) -> Float[np.ndarray, "4 4"]:
    """Read the extrinsics that Open3D writes, column by column; the identity without any."""
    if content is None:
        return np.eye(4)
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
    return matrix


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
