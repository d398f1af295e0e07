"""Line charts as SVG inside a page, in the page's own colours."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .page import Markup, element
from .pictures import round_up

#: size of a chart and its margins: left, right, top, bottom
WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 560.0, 300.0, 56.0, 14.0, 12.0, 46.0
#: approximate largest number of ticks of an axis
TICKS = 6


class Line(NamedTuple):
    """Points joined by a line; a point that is not finite interrupts it."""

    name: str
    x: Float[np.ndarray, "N"]
    y: Float[np.ndarray, "N"]
    #: classes of the page's style: c0 to c3 for a colour, `dashed`, `thin`
    style: str


def line_chart(
    title: str,
    lines: Sequence[Line],
    x_label: str,
    y_label: str,
    *,
    x_range: tuple[float, float] | None = None,
    y_range: tuple[float, float] | None = None,
) -> Markup:
    """Draw lines over axes with round numbers.

    The title is the accessible label, and is shown on hover. If ranges are not given, they are those of the
    lines, with a small margin.
    """
    low_x, high_x = data_range(np.concatenate([line.x for line in lines])) if x_range is None else x_range
    low_y, high_y = (
        data_range(np.concatenate([line.y for line in lines]), 0.06) if y_range is None else y_range
    )
    across, up = WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM

    def place_x(x):
        return LEFT + across * (x - low_x) / (high_x - low_x)

    def place_y(y):
        return TOP + up * (high_y - y) / (high_y - low_y)

    marks = []
    for value in ticks(low_y, high_y):
        at = round(float(place_y(value)), 1)
        marks.append(element("line", x1=LEFT, x2=WIDTH - RIGHT, y1=at, y2=at, class_="axis"))
        marks.append(element("text", format_number(value), x=LEFT - 8, y=at + 4, text_anchor="end"))
    for value in ticks(low_x, high_x):
        at = round(float(place_x(value)), 1)
        marks.append(element("line", x1=at, x2=at, y1=HEIGHT - BOTTOM, y2=HEIGHT - BOTTOM + 5, class_="axis"))
        marks.append(
            element("text", format_number(value), x=at, y=HEIGHT - BOTTOM + 19, text_anchor="middle")
        )
    middle = TOP + up / 2
    marks.append(element("text", x_label, x=LEFT + across / 2, y=HEIGHT - 6, text_anchor="middle"))
    marks.append(
        element("text", y_label, x=14, y=middle, text_anchor="middle", transform=f"rotate(-90 14 {middle:g})")
    )
    paths = [
        element("path", d=svg_path(place_x(line.x), place_y(line.y)), class_=f"line {line.style}")
        for line in lines
    ]
    title_element = element("title", title)
    return element(
        "svg", title_element, *marks, *paths, viewBox=f"0 0 {WIDTH:g} {HEIGHT:g}", class_="chart", role="img", aria_label=title
    )  # fmt: skip


def legend(lines: Sequence[Line]) -> Markup:
    """Build the legend of charts that share the same lines."""
    items = []
    for line in lines:
        stroke = element("path", d="M0 6 H32", class_=f"line {line.style}")
        items.append(
            element("li", element("svg", stroke, viewBox="0 0 32 12", aria_hidden="true"), line.name)
        )
    return element("ul", *items, class_="legend")


def svg_path(x: Float[np.ndarray, "N"], y: Float[np.ndarray, "N"]) -> str:
    """Build the `d` attribute of an SVG path through points."""
    words, pen = [], "M"
    for left, down in zip(x, y, strict=True):
        if np.isfinite(left) and np.isfinite(down):
            words.append(f"{pen}{left:.1f} {down:.1f}")
            pen = "L"
        else:
            pen = "M"
    return " ".join(words)


def data_range(values: Float[np.ndarray, "N"], margin: float = 0.0) -> tuple[float, float]:
    """Compute the range of finite values, extended by a share of it on both sides; never empty."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    beyond = margin * (high - low) if high > low else 0.5
    return low - beyond, high + beyond


def ticks(low: float, high: float) -> list[float]:
    """List evenly spaced round numbers between two values."""
    step = round_up((high - low) / TICKS)
    return [step * n for n in range(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1)]


def format_number(value: float) -> str:
    """Format a number as short as possible, with a typographic minus."""
    return f"{value:.6g}".replace("-", "−") if abs(value) > 1e-12 else "0"
