"""Pictures of bodies over the silhouettes that a depth camera saw."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from jaxcap.geometry.camera import look_at
from jaxcap.scanner.ray_casting import make_ray_mesh, render_depth

#: size of a drawn image, inches
SIZE = 2.4
#: distance of the view from the side, metres
DISTANCE = 3.0


class Overlay(NamedTuple):
    """The mask of the person in a frame, and renderings of a body from the camera and from the side."""

    mask: np.ndarray
    front: np.ndarray
    side: np.ndarray


def make_overlay(mask: np.ndarray, front: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> Overlay:
    """Add the view from the side to the mask and to the rendering from the camera, `front`."""
    middle = (vertices.min(0) + vertices.max(0)) / 2
    side_camera = look_at(middle + [DISTANCE, 0.0, 0.0], middle, 320, 420, 50)
    return Overlay(mask, front, render_depth(side_camera, make_ray_mesh(vertices, faces)).incidence_cosines)


def draw_overlays(path: Path, overlays: list[Overlay]) -> None:
    """Draw masks (red) with bodies (green), and below each the body from the side."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(SIZE * len(overlays), 2.3 * SIZE))
    axes = figure.subplots(2, len(overlays), squeeze=False)
    for column, (mask, front, side) in enumerate(overlays):
        axes[0][column].imshow(np.stack([mask.astype(float), front, np.zeros_like(front)], -1))
        axes[1][column].imshow(side, cmap="gray")
    for axis in axes.reshape(-1):
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(path, dpi=70)
