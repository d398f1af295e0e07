"""Depth images of a scanned motion, with masks of the person, as files."""

from pathlib import Path

from ...io.depth.images import write_depth_image, write_mask
from ...scanner.scan import LabelledDepth


def image_path(folder: Path, camera: int, frame: int, kind: str = "depth") -> Path:
    """Return the path of the depth image of a camera in a frame, or of its mask with the kind `mask`."""
    return folder / f"{kind}{camera}" / f"{frame:04d}.png"


def write_images(folder: Path, images: list[LabelledDepth], frame: int) -> None:
    """Write the depth images and masks of a frame; the mask of the first camera is written last, and so completes it."""
    for camera in reversed(range(len(images))):
        for kind in ("depth", "mask"):
            image_path(folder, camera, frame, kind).parent.mkdir(exist_ok=True)
        write_depth_image(image_path(folder, camera, frame), images[camera].depth)
        write_mask(image_path(folder, camera, frame, "mask"), images[camera].labels == 0)
