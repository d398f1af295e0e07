"""Draw `assets/skinning.png`: a bent and a twisted cylinder under each skinning scheme.

    python scripts/skinning_figure.py

The cylinder and the measures are those of `tests/project/test_artefacts.py`.
"""

import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from cylinder import SCHEMES, bulge, cross_section, posed_cylinder  # noqa: E402

TITLES = {"rigid": "rigid", "linear": "linear (LBS)", "dual_quaternion": "dual quaternion (DLB)"}


def main() -> None:
    """Draw two rows of four pictures, with measurements below each."""
    figure = plt.figure(figsize=(12, 7.2))
    for column, scheme in enumerate(SCHEMES):
        for row, (motion, degrees) in enumerate((("twist", 180.0), ("swing", 120.0))):
            vertices, faces = posed_cylinder(scheme, motion, degrees)
            axes = figure.add_subplot(2, 4, 4 * row + column + 1, projection="3d")
            draw(axes, vertices, faces, turned=row == 1)
            if motion == "twist":
                said = f"{100 * cross_section(vertices):.0f} % of the area remains"
                axes.set_title(TITLES.get(scheme, "swing-twist"), fontsize=13)
            else:
                said = f"bulges by {100 * bulge(vertices, degrees):.0f} % of the radius"
            axes.text2D(0.5, 0.0, said, transform=axes.transAxes, ha="center", fontsize=11)
    figure.text(0.01, 0.72, "twist 180°", rotation=90, va="center", fontsize=13)
    figure.text(0.01, 0.27, "swing 120°", rotation=90, va="center", fontsize=13)
    figure.subplots_adjust(0.02, 0.02, 1.0, 0.95, 0.0, 0.05)
    figure.savefig(ROOT / "assets" / "skinning.png", dpi=90)


def draw(axes, vertices: np.ndarray, faces: np.ndarray, turned: bool) -> None:
    """Draw triangles shaded by their normals, from the side of the bend."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = np.array([0.3, -0.8, 0.5]) / np.linalg.norm([0.3, -0.8, 0.5])
    shade = 0.35 + 0.6 * np.abs(normals @ light)
    colours = shade[:, None] * np.array([0.62, 0.78, 0.95])
    axes.add_collection3d(
        Poly3DCollection(corners, facecolors=colours, edgecolors=(0, 0, 0, 0.12), linewidths=0.2)
    )
    middle = (vertices.min(0) + vertices.max(0)) / 2
    half = np.ptp(vertices, axis=0).max() / 2
    for setter, centre in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), middle, strict=True):
        setter(centre - half, centre + half)
    axes.set_box_aspect((1, 1, 1), zoom=1.5 if turned else 1.6)
    axes.view_init(elev=12 if not turned else 8, azim=-75)
    axes.set_axis_off()


if __name__ == "__main__":
    main()
