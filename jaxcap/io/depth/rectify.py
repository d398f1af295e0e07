"""Sequences of depth images without the distortion of lenses."""

from collections.abc import Callable, Sequence

from ...arguments import checked
from ...depth.check_depths import check_image_size
from ...depth.rectify import make_rectification, rectify_depth, rectify_mask
from ...errors import InputError
from ...geometry.camera import Camera
from ..lazy_frames import LazyFrames
from .sequence import DepthFrame


@checked
def rectify_depths(
    cameras: Sequence[Camera], images: LazyFrames
) -> tuple[list[Camera], LazyFrames[DepthFrame]]:
    """Rectify sequences of depth images, each when it is loaded, and the cameras with them.

    Images of cameras without a lens stay as they are. The new cameras have none; their images may be larger.

    **Arguments:** `images`, from `read_depths`, with an image for each of the `cameras` in a frame.

    **Raises:** `InputError` if a lens shows nothing in its image; also, when a frame is loaded, if there are other numbers
    or sizes of images than of cameras.
    """
    rectified, rectify = make_rectifier(cameras)
    return rectified, LazyFrames(images.names, lambda number: rectify(images[number]))


def make_rectifier(cameras: Sequence[Camera]) -> tuple[list[Camera], Callable[[DepthFrame], DepthFrame]]:
    """Make the cameras without lenses, and the function that rectifies a frame of theirs. Raises as `rectify_depths`."""
    made = [None if camera.lens is None else make_rectification(camera) for camera in cameras]
    rectified = [camera if one is None else one.camera for camera, one in zip(cameras, made, strict=True)]

    def rectify(frame: DepthFrame) -> DepthFrame:
        if len(frame.depths) != len(cameras):
            raise InputError(
                f"{frame.name}: there are {len(frame.depths)} depth images of {len(cameras)} cameras; expected one of each."
            )
        depths, masks = list(frame.depths), list(frame.masks)
        for i, (camera, one) in enumerate(zip(cameras, made, strict=True)):
            check_image_size(camera, depths[i], "image", frame.files[i] if frame.files else frame.name)
            if one is None:
                continue
            depths[i] = rectify_depth(one, depths[i])
            mask = masks[i]
            masks[i] = None if mask is None else rectify_mask(one, mask)
        return frame._replace(depths=tuple(depths), masks=tuple(masks))

    return rectified, rectify if cameras else lambda frame: frame
