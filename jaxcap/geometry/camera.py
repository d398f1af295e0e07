"""Pinhole cameras: projection of points into images, and back-projection."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..arguments import as_jax_array, check_fields, checked
from ..errors import InputError
from ..value_checks import check_at_least, check_positive, concrete_values
from .lens import Lens, distort, largest_radius

#: smallest side of an image, pixels; largest number of pixels, above that of any depth camera
MIN_SIDE_PIXELS, MAX_PIXELS = 8, 25_000_000
#: largest number of cameras of a ring
MAX_CAMERAS = 1000
#: largest error of products of the rows of a rotation: files may have only four digits
ORTHONORMAL_TOLERANCE = 1e-2


class Camera(eqx.Module):
    """A calibrated pinhole camera, or one with a lens that distorts its images.

    A point `x` of the world, metres, is at `rotation @ x + translation` in the frame of the camera, with x
    to the right, y down and z forward. Pixels are counted from the upper left; the centre of the first one
    is at (0, 0). NumPy arrays are accepted and become JAX arrays.
    """

    rotation: Float[Array, "3 3"] = eqx.field(converter=as_jax_array)
    translation: Float[Array, "3"] = eqx.field(converter=as_jax_array)
    #: horizontal and vertical focal lengths, pixels
    focal: Float[Array, "2"] = eqx.field(converter=as_jax_array)
    #: intersection of the optical axis with the image, pixels
    principal_point: Float[Array, "2"] = eqx.field(converter=as_jax_array)
    #: number of columns and of rows, pixels
    width: int = eqx.field(static=True)
    height: int = eqx.field(static=True)
    #: None if images are not distorted, as those of `make_rectification` and of most depth cameras
    lens: Lens | None = None

    def __check_init__(self):
        check_fields(self)
        check_positive("Camera", "pixels", focal=self.focal)
        check_at_least("Camera", 1, width=self.width, height=self.height)
        axes = concrete_values(self.rotation)
        # negated so that NaN counts as wrong
        if axes is not None and not (
            np.abs(axes @ axes.T - np.eye(3)).max() < ORTHONORMAL_TOLERANCE and np.linalg.det(axes) > 0
        ):
            raise InputError(
                f"Camera: `rotation` is {axes.round(4).tolist()}; expected a rotation matrix with orthonormal rows "
                "and the determinant 1, not -1."
            )

    @property
    def eye(self) -> Float[Array, "3"]:
        """The position of the camera, metres."""
        return -self.translation @ self.rotation


def project_points(
    camera: Camera, points: Float[Array, "*points 3"]
) -> tuple[Float[Array, "*points 2"], Float[Array, "*points"]]:
    """Project points of the world to pixels `(column, row)` and depths along the optical axis, metres.

    Where a depth is not above zero the point is behind the camera, and its pixel has no meaning; nor has that of a ray
    beyond the range of the camera's lens (`largest_radius`).
    """
    points_in_camera = points @ camera.rotation.T + camera.translation
    depth = points_in_camera[..., 2]
    safe = jnp.where(depth > 0, depth, 1.0)[..., None]
    rays = points_in_camera[..., :2] / safe
    rays = rays if camera.lens is None else distort(camera.lens, rays)
    return camera.focal * rays + camera.principal_point, depth


@checked
def unproject(
    camera: Camera, pixels: Float[Array, "*points 2"], depth: Float[Array, "*points"]
) -> Float[Array, "*points 3"]:
    """Compute the points of the world, metres, from pixels and depths: the inverse of `project_points`.

    **Raises:** `InputError` if the camera has a lens; rectify its images.
    """
    check_rectified(camera)
    across = (pixels - camera.principal_point) / camera.focal * depth[..., None]
    there = jnp.concatenate([across, depth[..., None]], -1)
    return (there - camera.translation) @ camera.rotation


def is_in_image(camera: Camera, points: Float[Array, "*points 3"]) -> Bool[Array, "*points"]:
    """Test which points lie in front of the camera and within its image, occluded or not."""
    pixels, depth = project_points(camera, points)
    size = jnp.array([camera.width, camera.height])
    inside = (depth > 0) & jnp.all((pixels >= -0.5) & (pixels < size - 0.5), -1)
    if camera.lens is None:
        return inside
    # a lens maps rays far from its axis back into the image
    plain, _ = project_points(eqx.tree_at(lambda c: c.lens, camera, None), points)
    radius = jnp.linalg.norm((plain - camera.principal_point) / camera.focal, axis=-1)
    return inside & (radius < largest_radius(camera.lens))


def check_rectified(camera: Camera, where: str = "") -> None:
    """Check that the images of a camera are not distorted. Raises `InputError`, which begins with `where`."""
    if camera.lens is not None:
        raise InputError(
            f"{where + ': the' if where else 'The'} lens of the camera distorts its images; rectify them "
            "(`jc.io.rectify_depths`), and use the cameras that it returns."
        )


def check_no_lenses(cameras: Sequence[Camera], where: str = "Camera") -> None:
    """Check that no camera has a lens whose distortion would have to be simulated. Raises `InputError`."""
    for number, camera in enumerate(cameras):
        if camera.lens is not None:
            raise InputError(
                f"{where} {number} has a lens, whose distortion is not simulated; remove its distortion coefficients."
            )


def check_image_size(width: int, height: int, where: str = "") -> None:
    """Check the size of images. Raises `InputError`, which begins with `where`, for too few pixels or too
    many."""
    what = f"{where}: images" if where else "Images"
    if min(width, height) < MIN_SIDE_PIXELS:
        raise InputError(
            f"{what} of {width} x {height} pixels are too small; expected at least {MIN_SIDE_PIXELS} on each side."
        )
    if width * height > MAX_PIXELS:
        raise InputError(
            f"{what} of {width} x {height} pixels are too large; expected at most {MAX_PIXELS} pixels in total."
        )


@checked
def look_at(eye, target, width: int, height: int, field_of_view: float | int) -> Camera:
    """Create a camera at `eye (3,)` that looks at `target (3,)`, metres, upright where y is up.

    `field_of_view` is the horizontal angle of view, degrees. Pixels are square, and the principal point is
    the centre of the image.

    **Raises:** `InputError` for images of fewer than 8 pixels a side, an angle outside of 1 to 170 degrees,
    and a target that coincides with the eye.
    """
    check_image_size(width, height)
    if not 1 <= field_of_view <= 170:
        raise InputError(f"The field of view is {field_of_view:g} degrees; expected 1 to 170 degrees.")
    eye, target = np.asarray(eye, float), np.asarray(target, float)
    distance = np.linalg.norm(target - eye)
    if not (np.isfinite(distance) and distance > 1e-6):
        raise InputError(
            f"A camera at {_format_point(eye)} cannot look at {_format_point(target)}; expected two different finite positions."
        )
    forward = (target - eye) / distance
    # a camera that looks straight up or down has its x axis along the x axis of the world
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0, 0])
    rotation = np.stack([right, np.cross(forward, right), forward])
    focal = 0.5 * width / np.tan(0.5 * np.radians(field_of_view))
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    return Camera(rotation, -rotation @ eye, np.array([focal, focal]), middle, width, height)  # pyright: ignore[reportArgumentType]


@checked
def ring_of_cameras(
    count: int,
    arc: float | int,
    distance: float | int,
    height: float | int,
    target,
    resolution: tuple[int, int] = (320, 240),
    field_of_view: float | int = 60.0,
) -> list[Camera]:
    """Create cameras on an arc around the vertical through `target`, all looking at it.

    **Arguments:** `arc` in degrees, with its middle towards +z: less than 360 has a camera at each end, and
    a whole ring begins at +z and goes on towards +x; `distance` from the vertical and `height` above y = 0,
    metres; `target (3,)`; `resolution`, width and height in pixels; `field_of_view`, horizontal, degrees.

    **Raises:** `InputError` for no cameras or too many, an arc that is not above 0 and at most 360, a
    distance that is not above 0, a height that is not finite, and the errors of `look_at`.
    """
    if not 1 <= count <= MAX_CAMERAS:
        raise InputError(f"{count} views were requested; expected 1 to {MAX_CAMERAS}.")
    if not 0 < arc <= 360:
        raise InputError(f"The arc of cameras is {arc:g} degrees; expected more than 0 and at most 360.")
    if not 0 < distance < np.inf:
        raise InputError(
            f"The distance of the cameras is {distance:g} m from the body; expected a finite distance above 0."
        )
    if not np.isfinite(height):
        raise InputError(f"The height of the cameras is {height:g} m; expected a finite height.")
    if arc == 360:
        angles = np.radians(360.0 * np.arange(count) / count)
    else:
        angles = np.radians(np.linspace(-0.5, 0.5, count) * arc if count > 1 else np.zeros(1))
    target = np.asarray(target, float)
    return [
        look_at(
            [target[0] + distance * np.sin(angle), height, target[2] + distance * np.cos(angle)],
            target,
            *resolution,
            field_of_view,
        )
        for angle in angles
    ]


def check_views(cameras: Sequence[Camera], points: Float[np.ndarray, "N 3"], where: str) -> None:
    """Check that each camera has some of the points in its image; `where` names the cameras in messages.

    **Raises:** `InputError` for the first camera without any, by its number, with the reason: it looks away
    from them or past them.
    """
    for number, camera in enumerate(cameras):
        if bool(is_in_image(camera, jnp.asarray(points)).any()):
            continue
        behind = not bool((project_points(camera, jnp.asarray(points))[1] > 0).any())
        what = "points away from the body" if behind else "has the body outside of its image"
        raise InputError(
            f"{where}: camera {number} at {_format_point(np.asarray(camera.eye))} {what}; rotate it, move it or omit it."
        )


def _format_point(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in np.round(point, 3) + 0.0) + ")"
