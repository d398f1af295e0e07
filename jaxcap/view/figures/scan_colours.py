"""Colours of scans and bodies by scan distance and by body part posterior."""

import functools
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial import KDTree

from ...body.body import Body
from ...fit.correspondence.part_blocks import PartBlocks, make_part_blocks
from ...geometry.closest import nearest_on_surface
from ...geometry.mesh import vertex_normals
from ...geometry.normals import estimate_normals
from ...observe.clouds import Cloud, ordered_cloud, unit_normals
from ...report.pictures import HEAT_COLOURS
from ...report.render import distinct_colours
from ...tracking.expectation_maximisation.e_step import posterior
from .clouds import DisplayCloud, sample_rows

#: number of colours of a heat map: bands that a viewer can distinguish
NUM_BANDS = 12
#: number of points that get distances and posteriors; more would not look different
MAX_MEASURED_POINTS = 4_000
#: default standard deviation, metres, if a run's statistics have none
DEFAULT_SIGMA = 0.02
#: colour of a vertex that is nearest to no scan point
UNSEEN_COLOUR = (158, 163, 168)


class ScanHeat(NamedTuple):
    """Distances between a scan and a surface, metres."""

    #: the sampled points, and their positions
    points: Float[np.ndarray, "N 3"]
    distances: Float[np.ndarray, "N"]
    #: mean over the points nearest to the triangles around a vertex; NaN if there are none
    vertices: Float[np.ndarray, "V"]


@functools.cache
def heat_palette() -> UInt8[np.ndarray, "13 3"]:
    """Return the bands of the reports' heat maps, and last the colour of unobserved vertices; read-only."""
    from matplotlib.colors import LinearSegmentedColormap

    bands = LinearSegmentedColormap.from_list("heat", HEAT_COLOURS)((np.arange(NUM_BANDS) + 0.5) / NUM_BANDS)[
        :, :3
    ]
    palette = _append_unseen_colour(bands)
    palette.flags.writeable = False
    return palette


def heat_classes(heat: Float[np.ndarray, "N"], limit: float) -> Int[np.ndarray, "N"]:
    """Map each distance to its row of `heat_palette`. The last band begins `limit / 12` below `limit`, in the
    same unit, and includes everything beyond. NaN maps to the colour of unobserved vertices."""
    known = np.isfinite(heat)
    bands = np.minimum(np.where(known, heat, 0.0) * (NUM_BANDS / limit), NUM_BANDS - 1).astype(int)
    return np.where(known, bands, NUM_BANDS)


def scan_heat(
    cloud: DisplayCloud, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> ScanHeat:
    """Measure exact distances of a scan to a surface, at its points and averaged at their nearest vertices.

    Without faces the distances are to the vertices.
    """
    points = cloud.points[sample_rows(len(cloud.points), MAX_MEASURED_POINTS)]
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
    """Format a colour bar as HTML, with `limit` in metres."""
    colours = [f"rgb{tuple(int(value) for value in row)}" for row in heat_palette()[:NUM_BANDS]]
    stops = ", ".join(
        f"{colour} {100 * i / NUM_BANDS:.1f}% {100 * (i + 1) / NUM_BANDS:.1f}%"
        for i, colour in enumerate(colours)
    )
    grey = f"rgb{UNSEEN_COLOUR}"
    return (
        f'<div style="padding: 0 0.75em 0.5em; font-size: 0.8em">'
        f'<div style="height: 0.9em; background: linear-gradient(90deg, {stops})"></div>'
        f'<div style="display: flex; justify-content: space-between"><span>0</span>'
        f"<span>{500 * limit:g}</span><span>{1000 * limit:g} mm and more</span></div>"
        f'<span style="color: {grey}">&#9632;</span> no scan is nearest to it</div>'
    )


class PartColours(eqx.Module):
    """The inputs of the part posterior of a body, and a colour for each part."""

    body: Body
    parts: PartBlocks
    #: one colour for each joint, and the last for outliers
    palette: UInt8[np.ndarray, "K 3"]

    @property
    def vertices(self) -> Int[np.ndarray, "V"]:
        """The part of every vertex."""
        return np.asarray(self.body.skin.dominant_bones())


def make_part_colours(body: Body) -> PartColours:
    """Assign a colour to each part of a body, the same as in the reports' figures."""
    count = body.skeleton.num_joints
    palette = _append_unseen_colour(distinct_colours(count))
    return PartColours(body, make_part_blocks(body.skin.dominant_bones(), count, body.vertices), palette)


def posterior_colours(
    colours: PartColours,
    vertices: Float[np.ndarray, "V 3"],
    cloud: DisplayCloud,
    sigma: float = DEFAULT_SIGMA,
) -> tuple[Float[np.ndarray, "N 3"], UInt8[np.ndarray, "N 3"]]:
    """Sample points of a scan and colour them by part, mixed by their posteriors; grey is the share of
    outliers (Kineben, eq. 20). `sigma` is the mixture's standard deviation, metres."""
    rows = sample_rows(len(cloud.points), MAX_MEASURED_POINTS)
    points = cloud.points[rows]
    if len(colours.body.faces) == 0:
        # vertices without faces have no side, so any normal will do
        normals = np.zeros_like(points)
    else:
        normals = estimate_normals(points) if cloud.normals is None else cloud.normals[rows]
    # the unit of shown clouds is unknown
    judged = ordered_cloud(points, unit_normals(normals), np.ones(len(points)))
    found = _posterior(colours, np.asarray(vertices), judged, np.asarray(sigma))
    parts, weights, outlier = (
        np.asarray(values)[: len(points)] for values in (found.parts, found.weights, found.outlier)
    )
    palette = colours.palette.astype(float)
    mixed = np.einsum("nc,ncd->nd", weights, palette[parts]) + outlier[:, None] * palette[-1]
    # normalise over the likeliest parts, as the others are left out
    total = weights.sum(1) + outlier
    mixed = mixed / np.maximum(total, 1e-9)[:, None]
    return np.asarray(judged.points)[: len(points)], np.clip(np.rint(mixed), 0, 255).astype(np.uint8)


@eqx.filter_jit
def _posterior(colours: PartColours, vertices, cloud: Cloud, sigma):
    vertices = vertices.astype(cloud.points.dtype)
    normals = vertex_normals(vertices, colours.body.faces)
    return posterior(colours.parts, vertices, normals, cloud, sigma)


def _append_unseen_colour(colours: Float[np.ndarray, "K 3"]) -> UInt8[np.ndarray, "L 3"]:
    """Convert colours to 1 into a palette to 255, and append the colour of unobserved vertices."""
    return np.concatenate([np.rint(255 * colours), [UNSEEN_COLOUR]]).astype(np.uint8)
