"""Learning of joint limits from samples: one limit surface a joint, optionally coupled to a parent."""

from collections.abc import Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from ...arguments import checked
from ...errors import InputError
from ...geometry.sampling import even_indices
from ..chart import Chart
from ..implicit_surface import LimitSurface, SurfaceLimits, density
from ..primitives import LEVEL, STIFFNESS
from .choice import Choice, Sizes, find_choice
from .fit_chart import chart_coordinates, find_chart
from .full_turns import without_full_turns
from .held_out import HeldOut, make_folds
from .margins import GROWTH, RESOLUTION, choose_coupled_margin, choose_margin
from .primitive_matching import match_primitives
from .samples import JointSamples
from .voxel_size import choose_keyframes, choose_voxel_width
from .voxels import Voxels, voxelise

#: reach of a keyframe in units of its width: neighbours share only the space between them
KEYFRAME_REACH = 1 / 3
#: number of samples with computed densities, and of densities that are kept
NUM_SAMPLED, NUM_DENSITIES = 4000, 256


class Widths(NamedTuple):
    """Sizes in the chart, half of those in rotation, radians."""

    voxel: float
    #: width of the parent's keyframes; zero without a parent
    keyframe: float
    #: distance around voxels that is allowed
    margin: float
    #: growth of the margin with the distance of the parent from all keyframes
    growth: float = 0.0


@checked
def learn_limits(
    samples: Mapping[str, JointSamples],
    *,
    voxel: float | None = None,
    keyframe: float | None = None,
    margin: float | None = None,
    min_samples: int = 1,
    coverage: float | None = None,
    held_out: HeldOut | None = None,
    person_margin: float = 0.0,
) -> SurfaceLimits:
    """Learn the limits of some joints, by name, parents before their children.

    By default whole people, takes, or blocks of ten seconds (whichever is the largest of which there are several) are left
    out in turn. The limits are the tightest ones with which the others allow a share `coverage` of what is left out, on
    average. Between people and takes voxels are small, and a margin around them is chosen. Between blocks the width
    of the voxels is chosen, without a margin.

    Joints of the left and the right have charts of the same kind. A joint that turns through a full turn has no limits, and
    its children do not depend on it: see `find_full_turns`.

    **Arguments:** `voxel`, `keyframe` and `margin` are the widths of the smallest voxels of a joint, of the keyframes of
    its parent, and the margin around voxels, in radians of rotation. A given `voxel` has no margin unless one is given. A
    smallest voxel needs `min_samples` samples: the threshold of density. `coverage` is by default 0.99, and 0.98 between
    blocks; a joint and its parent together reach it between people or takes. `held_out` is `"people"`, `"takes"` or
    `"blocks"`. `person_margin`, radians, is added to the margin of every joint: what
    people differ by, where samples of one person are for others (ranges of adults have standard deviations of 5 to
    12 degrees: Boone and Azen 1979, Roaas and Andersson 1982).

    **Raises:** `InputError` where there is no joint, all turn through a full turn, or no voxel has `min_samples` samples.
    """
    if not samples:
        raise InputError("learn_limits: `samples` is empty; expected samples of at least one joint, by name.")
    samples = without_full_turns(samples)
    coupled = {one.parent.joint for one in samples.values() if one.parent is not None}
    surfaces = []
    for one in samples.values():
        # halves of rotations
        given = Sizes(*(None if each is None else each / 2 for each in (voxel, keyframe, margin)))
        choice = find_choice(one, given, held_out, coverage)
        if choice.left_out != "blocks" and (one.parent is not None or one.joint in coupled):
            # each of the two joints of a pair has half of what the pair may miss
            choice = choice._replace(coverage=1 - (1 - choice.coverage) / 2)
        charts = _charts(one, samples)
        coordinates = [
            None if chart is None else chart_coordinates(chart, each.rotations)
            for chart, each in zip(charts, (one, one.parent or one), strict=True)
        ]
        widths = _choose_widths(one, charts, coordinates, given, choice, min_samples)
        widths = widths._replace(margin=widths.margin + person_margin / 2)
        surfaces.append(_make_surface(one, charts, coordinates, widths, min_samples))
    return SurfaceLimits(tuple(surfaces))


def _charts(one: JointSamples, samples: Mapping[str, JointSamples]) -> tuple[Chart, Chart | None]:
    """Find the charts of a joint and of its parent, of the same kinds as those of the other side."""

    def chart(each: JointSamples) -> Chart:
        other = None if each.anatomy is None else each.anatomy.other_side
        pair = [s for s in samples.values() if s.anatomy is not None and s.anatomy.name == other]
        found = find_chart(each)
        differs = bool(pair) and find_chart(pair[0]).kind != found.kind
        return find_chart(each._replace(kind="ball"), least=3) if differs else found

    return chart(one), None if one.parent is None else chart(one.parent)


def _choose_widths(
    samples: JointSamples, charts, coordinates, given: Sizes, choice: Choice, min_samples: int
) -> Widths:
    """Choose the sizes that are not given, by cross-validation."""
    (chart, parent_chart), (own, above), (voxel, keyframe, margin) = charts, coordinates, given
    share = choice.coverage
    if choice.left_out == "blocks":
        if parent_chart is None:
            width = voxel or choose_voxel_width(own, chart.dimension, samples.blocks, min_samples, share)
            return Widths(width, 0.0, margin or 0.0)
        if choice.chosen:
            dimensions = chart.dimension, parent_chart.dimension
            voxel, keyframe = choose_keyframes(
                own, above, dimensions, samples.blocks, min_samples, share, voxel, keyframe
            )
        assert voxel is not None and keyframe is not None
        return Widths(voxel, keyframe, margin or 0.0)
    width = np.radians(RESOLUTION[chart.dimension]) / 2
    if not choice.chosen:
        return Widths(width, keyframe or 0.0, margin or 0.0, 0.0 if samples.parent is None else GROWTH)
    folds = make_folds(samples, choice.left_out)
    if parent_chart is None:
        return Widths(width, 0.0, choose_margin(own, chart.dimension, folds, width, min_samples, share))
    dimensions = chart.dimension, parent_chart.dimension
    chosen = choose_coupled_margin(own, above, dimensions, folds, width, min_samples, share, keyframe)
    return Widths(width, chosen.keyframe, chosen.margin if margin is None else margin, chosen.growth)


def _make_surface(
    samples: JointSamples, charts, coordinates, widths: Widths, min_samples: int
) -> LimitSurface:
    """Make the limit surface of one joint from its coordinates."""
    chart, parent_chart = charts
    coordinates, parents = coordinates
    if samples.parent is None:
        voxels = voxelise(coordinates, chart.dimension, widths.voxel, min_samples)
        centres, thickness = voxels.centres[None], _thickness(voxels.widths, chart, widths)[None]
        keys, reach, counts, key_radius = np.zeros((1, 3)), 1.0, voxels.counts[None], 0.0
    else:
        # voxels of one size, so that the voxels of a keyframe are a subset of all
        voxels = voxelise(coordinates, chart.dimension, widths.voxel, min_samples, levels=0)
        keys, keyed = _keyframes(coordinates, parents, voxels, parent_chart.dimension, widths.keyframe)
        matched = [
            np.arange(len(voxels.counts)) if seen.all() else _match_to_keyframe(voxels, seen)
            for seen in keyed
        ]
        home = _nearest_centre(keys, parents), _nearest_centre(voxels.centres, coordinates)
        counts = np.zeros((len(keys), len(voxels.counts)))
        np.add.at(counts, home, 1.0)
        centres = np.stack([voxels.centres[rows] for rows in matched])
        thickness = np.tile(_thickness(voxels.widths, chart, widths), (len(keys), 1))
        reach = KEYFRAME_REACH * widths.keyframe
        key_radius = np.sqrt(parent_chart.dimension) * widths.keyframe / 2
        # counts belong to the voxels themselves; primitives of voxels that a keyframe lacks are elsewhere
        counts = _distribute_counts(counts, matched)
    above = samples.parent
    surface = LimitSurface(
        joint=samples.joint,
        parent=None if above is None else above.joint,
        chart=chart,
        parent_chart=parent_chart,
        keys=jnp.asarray(keys),
        reach=jnp.asarray(reach),
        centres=jnp.asarray(centres),
        thickness=jnp.asarray(thickness),
        unit=jnp.asarray(widths.voxel / 2),
        level=jnp.asarray(LEVEL),
        stiffness=jnp.asarray(STIFFNESS),
        counts=jnp.asarray(counts),
        densities=jnp.zeros(0),
        margin=jnp.asarray(widths.margin),
        growth=jnp.asarray(widths.growth),
        key_radius=jnp.asarray(key_radius),
        anatomy=samples.anatomy,
        parent_anatomy=None if above is None else above.anatomy,
        rest=samples.rest,
        parent_rest=None if above is None else above.rest,
    )
    return _with_densities(surface, coordinates, parents)


def _thickness(widths: Float[np.ndarray, "N"], chart: Chart, sizes: Widths) -> Float[np.ndarray, "N"]:
    """Compute the thickness with which a primitive alone contains its whole voxel, and the margin around it, within
    the level.

    In the paper the influence ends at half a voxel's width. Then no corner of a voxel is within the level,
    and samples that the surface was made of are forbidden.
    """
    return np.sqrt(chart.dimension) * widths / 2 + (LEVEL - 1) / STIFFNESS * sizes.voxel / 2 + sizes.margin


def _keyframes(coordinates, parent_coordinates, voxels: Voxels, dimension: int, width: float):
    """Compute voxels of the parent as keyframes, and a mask `(V, N)` of the child's voxels at each.

    A child's voxel is at a keyframe if it has a sample with the parent in that keyframe or up to half a
    width around it.
    """
    keyframes = voxelise(parent_coordinates, dimension, width, levels=0)
    home = _nearest_centre(voxels.centres, coordinates)
    keyed = np.zeros((len(keyframes.counts), len(voxels.counts)), bool)
    for row, key in enumerate(keyframes.centres):
        keyed[row, home[np.abs(parent_coordinates - key).max(1) <= width]] = True
    return keyframes.centres, keyed


def _match_to_keyframe(voxels: Voxels, in_keyframe: np.ndarray) -> np.ndarray:
    """Map each voxel to its match in a keyframe."""
    chosen = match_primitives(
        voxels.centres, voxels.widths / 2, voxels.centres[in_keyframe], voxels.widths[in_keyframe] / 2
    )
    return np.flatnonzero(in_keyframe)[chosen]


def _distribute_counts(counts: np.ndarray, matched: list[np.ndarray]) -> np.ndarray:
    """Divide each voxel's count by the number of primitives at its position at a keyframe."""
    rows = []
    for count, chosen in zip(counts, matched, strict=True):
        rows.append(count[chosen] / np.bincount(chosen, minlength=len(count))[chosen])
    return np.stack(rows)


def _nearest_centre(centres: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.asarray(KDTree(centres).query(points)[1])


def _with_densities(surface: LimitSurface, coordinates, parent_coordinates) -> LimitSurface:
    """Add the sorted densities at samples, which are the reference for comfort."""
    chosen = np.random.default_rng(0).permutation(len(coordinates))[:NUM_SAMPLED]
    found = _densities(
        surface,
        jnp.asarray(coordinates[chosen]),
        None if parent_coordinates is None else jnp.asarray(parent_coordinates[chosen]),
    )
    ranks = even_indices(len(chosen), NUM_DENSITIES, nearest=True)
    return eqx.tree_at(lambda s: s.densities, surface, jnp.sort(found)[ranks])


@jax.jit
def _densities(surface: LimitSurface, coordinates, parent_coordinates):
    return jax.lax.map(lambda at: density(surface, *at), (coordinates, parent_coordinates))
