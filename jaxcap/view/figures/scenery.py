"""The surroundings of the figures in a window: light, a background and a floor, in contrast to bodies, bones
and scans."""

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from viser import GridHandle, SceneApi
else:
    GridHandle = SceneApi = Any

#: colours of the background, above and below; light enough for titles, dark enough for a grey body
SKY, HORIZON = (247, 249, 252), (196, 205, 217)
FLOOR, LINES, SECTIONS = (176, 184, 195), (150, 159, 172), (112, 122, 138)


def add_light(scene: SceneApi) -> None:
    """Light a scene by a hemisphere light and a sun without shadows. viser's own environment map and its
    shadows look no better on a grey body, and software rendering in a browser takes three times as long with
    them."""
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/lights/sky", ground_color=(120, 116, 112), intensity=2.2)
    scene.add_light_directional("/lights/sun", intensity=1.6, position=(1.0, 2.0, 2.0))


def add_background(scene: SceneApi) -> None:
    """Set a background image with a gradient from light above to a darker grey below."""
    share = np.linspace(0.0, 1.0, 256)[:, None, None] ** 1.5
    rows = (1 - share) * np.array(SKY) + share * np.array(HORIZON)
    scene.set_background_image(np.tile(rows, (1, 16, 1)).round().astype(np.uint8), format="png")


def add_floor(scene: SceneApi, size: float, cell: float) -> GridHandle:
    """Add a horizontal floor, `size` metres wide, with lines every `cell` metres and darker ones every five."""
    return scene.add_grid(
        "/ground", width=size, height=size, plane="xz", cell_size=cell, section_size=5 * cell,
        cell_color=LINES, section_color=SECTIONS, section_thickness=1.5, plane_color=FLOOR, plane_opacity=0.55,
        shadow_opacity=0.0, fade_distance=4 * size,
    )  # fmt: skip
