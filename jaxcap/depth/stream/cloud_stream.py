"""Clouds of a person in successive depth images of cameras that do not move, made in milliseconds."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ...arguments import checked
from ...errors import InputError
from ...geometry.camera import Camera
from ...observe import DepthView
from ...observe.clouds import Cloud, ordered_cloud, padded_size
from ...value_checks import check_at_least
from ..background import Background, take_background
from ..check_depths import check_image_size_of, keep_measured
from ..clouds import GAP, VOXEL
from ..fuse import average_in_voxels
from ..person import check_found, check_measured, search_person
from ..shadows import fill_shadows
from ..views import NUM_LEVELS, reduce_camera, take_pixels, view_images, view_step
from .fixed_camera import FixedCamera, ImageBox
from .follow_person import follow_person
from .pixel_surface import pixel_surface, warm_up_pixels
from .thin import thin_points

#: rows and columns around a pixel for its normal
WINDOW = 2
#: default number of points of a cloud
NUM_POINTS = 1024


class CloudStream:
    """Clouds of successive frames, all of one size, so that nothing is compiled for a frame.

    The person is searched for in the whole image once, with floor and walls. In later frames it is followed: only the part of
    an image near the last surface is read. The clouds are those of `cloud_of_depths`, thinned to `num_points`
    (`thin_points`).

    **Arguments:** `voxel`, side of the cubes that keep one point each, metres; `pixel_step`: only every so-many-th row and column
    of an image is read; `backgrounds`, one for each camera, of `estimate_background`, whose surface is not of the person.

    **Raises:** `InputError` for no cameras, a `pixel_step` below one, or other numbers or sizes of backgrounds than of cameras.
    """

    @checked
    def __init__(
        self,
        cameras: Sequence[Camera],
        num_points: int = NUM_POINTS,
        voxel: float = VOXEL,
        pixel_step: int = 1,
        backgrounds: Sequence[Background | None] | None = None,
    ):
        if not cameras:
            raise InputError("There are no cameras; give one for each sequence of depth images.")
        check_at_least("CloudStream", 1, pixel_step=pixel_step)
        self._whole = list(cameras)
        backgrounds = [None] * len(cameras) if backgrounds is None else backgrounds
        if len(backgrounds) != len(cameras):
            raise InputError(
                f"There are {len(backgrounds)} backgrounds of {len(cameras)} cameras; give one of each."
            )
        for number, (camera, known) in enumerate(zip(cameras, backgrounds, strict=True)):
            if known is not None:
                check_image_size_of(camera, known.depth, "background", f"camera {number}")
        cameras = [take_pixels(camera, pixel_step) for camera in cameras]
        self.cameras = [
            FixedCamera(camera, None if known is None else take_background(known, pixel_step))
            for camera, known in zip(cameras, backgrounds, strict=True)
        ]
        self.num_points, self.voxel, self.pixel_step = num_points, voxel, pixel_step
        self._views = [reduce_camera(camera, view_step(camera.height, camera.width)) for camera in cameras]

    def warm_up(self) -> None:
        """Compile what any number of pixels needs."""
        for fixed in self.cameras:
            warm_up_pixels(fixed, GAP, WINDOW)

    def make(
        self,
        depths: Sequence[Float[np.ndarray, "H W"]],
        surface: Float[np.ndarray, "N 3"] | None = None,
        name: str = "the frame",
    ) -> Cloud:
        """Make the cloud of one frame.

        **Arguments:** `depths`, metres, zero where nothing was measured; `surface`, points on the posed body of one of the last
        frames, without which the person is searched for; `name` for messages.

        **Raises:** `InputError` if there are other numbers or sizes of images than of cameras, or no person is found.
        """
        if len(depths) != len(self.cameras):
            raise InputError(
                f"{name}: there are {len(depths)} depth images of {len(self.cameras)} cameras; expected one of each."
            )
        points, normals, views = [], [], []
        for number, (fixed, depth) in enumerate(zip(self.cameras, depths, strict=True)):
            where = name if len(depths) == 1 else f"{name}, camera {number}"
            check_image_size_of(self._whole[number], depth, "image", where)
            depth = keep_measured(depth[:: self.pixel_step, :: self.pixel_step])
            box, person = self._person(fixed, depth, surface, where)
            # single precision is enough for pixels of one image, and faster
            here = depth[box.rows, box.columns].astype(np.float32)
            alone = np.where(person, here, np.float32(0.0))
            surface_of_pixels = pixel_surface(fixed, box, alone, GAP, WINDOW)
            points.append(surface_of_pixels[0])
            normals.append(surface_of_pixels[1])
            views.append(self._view(number, box, here, person))
        at, along = np.concatenate(points), np.concatenate(normals)
        if not len(at):
            raise InputError(f"{name}: no pixel of the person was measured; leave out the frame.")
        at, along, _ = average_in_voxels(at, along, np.zeros(len(at), int), self.voxel)
        # without a normal a point is at an edge, and may be between front and back
        sure = np.any(along != 0, 1)
        thinned = thin_points(at[sure], along[sure], self.voxel, self.num_points)
        cloud = ordered_cloud(*thinned, size=padded_size(self.num_points))
        return Cloud(cloud.points, cloud.normals, cloud.weights, tuple(views))

    def _person(
        self,
        fixed: FixedCamera,
        depth: Float[np.ndarray, "H W"],
        surface: Float[np.ndarray, "N 3"] | None,
        where: str,
    ) -> tuple[ImageBox, Bool[np.ndarray, "h w"]]:
        """Follow the person near the last surface, or find it in the whole image, always in the first one."""
        followed = None
        if surface is not None and fixed.is_searched:
            followed = follow_person(fixed, depth, surface)
        if followed is not None:
            return followed
        check_measured(fixed.camera, depth, where)
        found = check_found(search_person(fixed.camera, depth, fixed.background, where), where)
        fixed.set_planes(found.planes)
        height, width = depth.shape
        return ImageBox(slice(0, height), slice(0, width), 0.0, np.inf), found.person

    def _view(
        self, number: int, box: ImageBox, depth: Float[np.ndarray, "h w"], person: Bool[np.ndarray, "h w"]
    ) -> DepthView:
        """Make the view of a camera; outside of the box nothing counts as measured."""
        fixed, small = self.cameras[number], self._views[number]
        step = view_step(fixed.camera.height, fixed.camera.width)
        filled = fill_shadows(depth, person, float(fixed.focal[0]))
        depths, levels, distances = view_images(filled, person, step)
        row, column = box.rows.start // step, box.columns.start // step
        here = np.s_[..., row : row + depths.shape[0], column : column + depths.shape[1]]
        whole = np.zeros((1 + NUM_LEVELS, small.height, small.width), np.float32)
        whole[here] = np.concatenate([depths[None], distances])
        return DepthView(small, whole[0], levels, whole[1:])
