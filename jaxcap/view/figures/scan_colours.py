"""Colours that say something: how far scans are from a body, and which part of it each point is taken for."""

import functools
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import KDTree

from ...body.body import Body
from ...fit.correspondence.part_blocks import Parts, make_parts
from ...fit.correspondence.posterior import posterior
from ...geometry.closest import nearest_on_surface
from ...geometry.mesh import vertex_normals
from ...geometry.normals import estimate_normals
from ...observe import Cloud, ordered_cloud, unit_normals
from ...report.pictures import HEAT
from ...report.render import distinct_colours
from .clouds import SeenCloud, some_rows

#: colours of a heat map: bands that can be told apart
BANDS = 12
#: points that distances and posteriors are computed for; more would not be drawn otherwise
JUDGED = 4_000
#: metres of deviation where a run's statistics do not tell it
SIGMA = 0.02
#: no scan was nearest to it
UNSEEN = (158, 163, 168)


class ScanHeat(NamedTuple):
    """Distances between a scan and a surface, metres."""

    #: of the points that were judged, and where they are
    points: Float[np.ndarray, "N 3"]
    distances: Float[np.ndarray, "N"]
    #: mean over the points nearest to the triangles around a vertex; NaN where there are none
    vertices: Float[np.ndarray, "V"]


@functools.cache
def heat_palette() -> UInt8[np.ndarray, "13 3"]:
    """The bands of the reports' heat maps, and behind them what was not seen; not to be written to."""
    from matplotlib.colors import LinearSegmentedColormap

    bands = LinearSegmentedColormap.from_list("heat", HEAT)((np.arange(BANDS) + 0.5) / BANDS)[:, :3]
    palette = _with_unseen(bands)
    palette.flags.writeable = False
    return palette


def heat_classes(heat: Float[np.ndarray, "N"], limit: float) -> Int[np.ndarray, "N"]:
    """The row of `heat_palette` of each distance, where the last band begins `limit / 12` below `limit`, the
    unit of both, and holds all that is beyond. NaN is what was not seen."""
    known = np.isfinite(heat)
    bands = np.minimum(np.where(known, heat, 0.0) * (BANDS / limit), BANDS - 1).astype(int)
    return np.where(known, bands, BANDS)


def scan_heat(
    cloud: SeenCloud, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> ScanHeat:
    """How far a scan is from a surface, exactly, at its points and on average at the vertices they are nearest to.

    A body without faces is its vertices.
    """
    points = cloud.points[some_rows(len(cloud.points), JUDGED)]
    sums = np.zeros((len(vertices), 2))
    if len(faces):
        found = nearest_on_surface(points, vertices, faces)
        distances, near = found.distances, np.asarray(faces)[found.triangles]
    else:
        distances, near = KDTree(vertices).query(points)
        near = np.asarray(near)[:, None]
    both = np.stack([distances, np.ones_like(distances)], 1)
    np.add.at(sums, near, both[:, None])
    heat = np.where(sums[:, 1] > 0, sums[:, 0] / np.maximum(sums[:, 1], 1.0), np.nan)
    return ScanHeat(points, np.asarray(distances, float), heat)


def heat_legend(limit: float) -> str:
    """A bar of the colours as HTML, with `limit` in metres."""
    colours = [f"rgb{tuple(int(value) for value in row)}" for row in heat_palette()[:BANDS]]
    stops = ", ".join(
        f"{colour} {100 * i / BANDS:.1f}% {100 * (i + 1) / BANDS:.1f}%" for i, colour in enumerate(colours)
    )
    grey = f"rgb{UNSEEN}"
    return (
        f'<div style="padding: 0 0.75em 0.5em; font-size: 0.8em">'
        f'<div style="height: 0.9em; background: linear-gradient(90deg, {stops})"></div>'
        f'<div style="display: flex; justify-content: space-between"><span>0</span>'
        f"<span>{500 * limit:g}</span><span>{1000 * limit:g} mm and more</span></div>"
        f'<span style="color: {grey}">&#9632;</span> no scan is nearest to it</div>'
    )


class PartColours(eqx.Module):
    """What the posterior of a body's parts at points needs of the body, and a colour for each part."""

    body: Body
    parts: Parts
    #: one for each joint, and one for what belongs to none
    palette: UInt8[np.ndarray, "K 3"]

    @property
    def vertices(self) -> Int[np.ndarray, "V"]:
        """The part of every vertex."""
        return np.asarray(self.body.skin.parts())


def make_part_colours(body: Body) -> PartColours:
    """Colours of a body's parts, those of the reports' pictures."""
    count = body.skeleton.num_joints
    palette = _with_unseen(distinct_colours(count))
    return PartColours(body, make_parts(body.skin.parts(), count, body.vertices), palette)


def posterior_colours(
    colours: PartColours, vertices: Float[np.ndarray, "V 3"], cloud: SeenCloud, sigma: float = SIGMA
) -> tuple[Float[np.ndarray, "N 3"], UInt8[np.ndarray, "N 3"]]:
    """Some points of a scan, and the colours of the parts they are taken for, mixed by their posteriors; grey is
    the share of no part (Kineben, eq. 20). `sigma` is the mixture's deviation, metres."""
    rows = some_rows(len(cloud.points), JUDGED)
    points = cloud.points[rows]
    if len(colours.body.faces) == 0:
        # without a side to its vertices any normal will do
        normals = np.zeros_like(points)
    else:
        normals = estimate_normals(points) if cloud.normals is None else cloud.normals[rows]
    # what is shown may be of any unit
    judged = ordered_cloud(points, unit_normals(normals), np.ones(len(points)))
    found = _posterior(colours, np.asarray(vertices), judged, np.asarray(sigma))
    parts, weights, outlier = (
        np.asarray(values)[: len(points)] for values in (found.parts, found.weights, found.outlier)
    )
    palette = colours.palette.astype(float)
    mixed = np.einsum("nc,ncd->nd", weights, palette[parts]) + outlier[:, None] * palette[-1]
    # what is left out of the likeliest parts is shared out among them
    total = weights.sum(1) + outlier
    mixed = mixed / np.maximum(total, 1e-9)[:, None]
    return np.asarray(judged.points)[: len(points)], np.clip(np.rint(mixed), 0, 255).astype(np.uint8)


@eqx.filter_jit
def _posterior(colours: PartColours, vertices, cloud: Cloud, sigma):
    vertices = vertices.astype(cloud.points.dtype)
    normals = vertex_normals(vertices, colours.body.faces)
    return posterior(colours.parts, vertices, normals, cloud, sigma)


def _with_unseen(colours: Float[np.ndarray, "K 3"]) -> UInt8[np.ndarray, "L 3"]:
    """Colours to 1 as a palette to 255, and behind them that of what was not seen."""
    return np.concatenate([np.rint(255 * colours), [UNSEEN]]).astype(np.uint8)
