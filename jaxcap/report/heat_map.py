"""Heat maps of a body from the front and the back, coloured by the distance from scans."""

import base64
import io
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..arguments import checked
from ..body.body import Body
from .chart import TICKS, format_number, ticks
from .page import Markup, element
from .pictures import HEAT_COLOURS, new_figure, round_up
from .render import draw_surface, rotate_view, set_frame

#: colour of vertices that are nearest to no scanned point
UNSEEN_COLOUR = np.array([0.62, 0.64, 0.66])
#: height of a body in a picture, inches
BODY_HEIGHT = 4.2


def heat_limit(heats: Sequence[Float[np.ndarray, "_"]]) -> float:
    """Compute the upper end of a common colour scale, in the unit of the heats; few vertices exceed it."""
    known = np.concatenate([heat[np.isfinite(heat)] for heat in heats])
    if not len(known):
        return 1.0
    high = float(np.quantile(known, 0.96))
    return round_up(high / TICKS) * float(np.ceil(high / round_up(high / TICKS)))


@checked
def heat_pictures(bodies: Sequence[Body], heats: Sequence[Float[np.ndarray, "_"]], limit: float) -> list[str]:
    """Render every body at rest, front and back, on common size and colour scales; each picture is a data
    URI.

    Vertices whose heat is NaN are grey. Bodies have y up.
    """
    positions = [np.asarray(body.vertices, float) for body in bodies]
    view = front_view(positions[-1])
    middles = [0.5 * (place.min(0) + place.max(0)) for place in positions]
    seen = [(place - middle) @ view.T for place, middle in zip(positions, middles, strict=True)]
    reach = np.max([np.abs(place).max(0) for place in seen], axis=0)
    return [
        _picture(place - middle, np.asarray(body.faces), heat, limit, view, reach[:2])
        for body, place, middle, heat in zip(bodies, positions, middles, heats, strict=True)
    ]


def colour_scale(limit: float, unit: str, unseen: str) -> Markup:
    """Build the legend of `heat_pictures`, with `limit` in a unit; `unseen` explains grey."""
    bar = element("div", class_="bar", style=f"background: linear-gradient(90deg, {', '.join(HEAT_COLOURS)})")
    values = [format_number(value) for value in ticks(0.0, limit)]
    ends = element("div", *(element("span", value) for value in values), class_="ends")
    legend = f"Mean distance, {unit}; {values[-1]} and more are dark red. {unseen}"
    return element("div", bar, ends, element("div", legend), class_="scale")


def front_view(vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "3 3"]:
    """Choose the view from the front: rows are right, up (y), and towards the eye along the shallower other
    axis."""
    sides = np.ptp(vertices, axis=0)
    towards = np.eye(3)[2 if sides[2] <= sides[0] else 0]
    return np.stack([np.cross([0.0, 1.0, 0.0], towards), [0.0, 1.0, 0.0], towards])


def _picture(
    vertices: Float[np.ndarray, "V 3"],
    faces: np.ndarray,
    heat: Float[np.ndarray, "V"],
    limit: float,
    view: Float[np.ndarray, "3 3"],
    reach: Float[np.ndarray, "2"],
) -> str:
    from matplotlib.colors import LinearSegmentedColormap

    known = np.isfinite(heat)
    colours = LinearSegmentedColormap.from_list("heat", HEAT_COLOURS)(np.where(known, heat, 0.0) / limit)[
        :, :3
    ]
    paint = np.where(known[:, None], colours, UNSEEN_COLOUR)
    wide = float(np.clip(BODY_HEIGHT * reach[0] / reach[1], 1.2, 6.0))
    canvas, figure = new_figure(2 * wide, BODY_HEIGHT)
    # the page background may be light or dark
    figure.set_facecolor("none")
    for plot, degrees in zip(figure.subplots(1, 2), (0.0, 180.0), strict=True):
        draw_surface(plot, vertices, faces, rotate_view(view, degrees), paint)
        set_frame(plot, -reach, reach)
    figure.subplots_adjust(left=0, right=1, top=1, bottom=0, wspace=0)
    buffer = io.BytesIO()
    canvas.print_png(buffer)
    return f"data:image/png;base64,{base64.b64encode(buffer.getvalue()).decode()}"
