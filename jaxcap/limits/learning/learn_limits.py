"""Learning of joint limits from samples: one limit surface a joint, optionally coupled to a parent."""

from collections.abc import Mapping

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
from .fit_chart import chart_coordinates, find_chart
from .primitive_matching import match_primitives
from .samples import JointSamples
from .voxel_size import choose_keyframes, choose_voxel_width
from .voxels import Voxels, voxelise

#: share of a motion outside the training samples that is to be allowed
COVERAGE = 0.98
#: reach of a keyframe in units of its width: neighbours share only the space between them
KEYFRAME_REACH = 1 / 3
#: number of samples with computed densities, and of densities that are kept
NUM_SAMPLED, NUM_DENSITIES = 4000, 256


@checked
def learn_limits(
    samples: Mapping[str, JointSamples],
    *,
    voxel: float | None = None,
    keyframe: float | None = None,
    min_samples: int = 1,
    coverage: float = COVERAGE,
) -> SurfaceLimits:
    """Learn the limits of some joints, by name, parents before their children.

    **Arguments:** `voxel` and `keyframe` are the widths of the smallest voxels of a joint and of the
    keyframes of its parent in radians of rotation; by default the tightest ones with which a share
    `coverage` of held-out blocks is allowed by the others. A smallest voxel needs `min_samples` samples: the
    threshold of density.

    **Raises:** `InputError` where there is no joint, a joint's rotations wrap, or no voxel has `min_samples`
    samples.
    """
    if not samples:
        raise InputError("learn_limits: `samples` is empty; expected samples of at least one joint, by name.")
    return SurfaceLimits(
        tuple(learn_surface(one, voxel, keyframe, min_samples, coverage) for one in samples.values())
    )


def learn_surface(
    samples: JointSamples,
    voxel: float | None = None,
    keyframe: float | None = None,
    min_samples: int = 1,
    coverage: float = COVERAGE,
) -> LimitSurface:
    """Learn the limits of one joint; arguments and errors as in `learn_limits`, widths in radians."""
    chart = find_chart(samples)
    coordinates = chart_coordinates(chart, samples.rotations)
    if samples.parent is None:
        width = (voxel or 0.0) / 2 or choose_voxel_width(
            coordinates, chart.dimension, samples.blocks, min_samples, coverage
        )
        voxels = voxelise(coordinates, chart.dimension, width, min_samples)
        return _uncoupled_surface(samples, chart, coordinates, voxels, width)
    parent_chart = find_chart(samples.parent)
    parents = chart_coordinates(parent_chart, samples.parent.rotations)
    width, key_width = (voxel or 0.0) / 2, (keyframe or 0.0) / 2
    if not (voxel and keyframe):
        dimensions = chart.dimension, parent_chart.dimension
        chosen = choose_keyframes(coordinates, parents, dimensions, samples.blocks, coverage)
        width, key_width = width or chosen[0], key_width or chosen[1]
    # voxels of one size, so that the voxels of a keyframe are a subset of all
    voxels = voxelise(coordinates, chart.dimension, width, min_samples, levels=0)
    keys, keyed = _keyframes(coordinates, parents, voxels, parent_chart.dimension, key_width)
    matched = [
        np.arange(len(voxels.counts)) if seen.all() else _match_to_keyframe(voxels, seen) for seen in keyed
    ]
    home = _nearest_centre(keys, parents), _nearest_centre(voxels.centres, coordinates)
    counts = np.zeros((len(keys), len(voxels.counts)))
    np.add.at(counts, home, 1.0)
    surface = LimitSurface(
        joint=samples.joint,
        parent=samples.parent.joint,
        chart=chart,
        parent_chart=parent_chart,
        keys=jnp.asarray(keys),
        reach=jnp.asarray(KEYFRAME_REACH * key_width),
        centres=jnp.asarray(np.stack([voxels.centres[rows] for rows in matched])),
        thickness=jnp.asarray(np.tile(_thickness(voxels.widths, chart, width), (len(keys), 1))),
        unit=jnp.asarray(width / 2),
        level=jnp.asarray(LEVEL),
        stiffness=jnp.asarray(STIFFNESS),
        # counts belong to the voxels themselves; primitives of voxels that a keyframe lacks are elsewhere
        counts=jnp.asarray(_distribute_counts(counts, matched)),
        densities=jnp.zeros(0),
        bone=jnp.asarray(samples.bone),
    )
    return _with_densities(surface, coordinates, parents)


def _uncoupled_surface(
    samples: JointSamples, chart: Chart, coordinates, voxels: Voxels, width: float
) -> LimitSurface:
    surface = LimitSurface(
        joint=samples.joint,
        parent=None,
        chart=chart,
        parent_chart=None,
        keys=jnp.zeros((1, 3)),
        reach=jnp.asarray(1.0),
        centres=jnp.asarray(voxels.centres[None]),
        thickness=jnp.asarray(_thickness(voxels.widths, chart, width)[None]),
        unit=jnp.asarray(width / 2),
        level=jnp.asarray(LEVEL),
        stiffness=jnp.asarray(STIFFNESS),
        counts=jnp.asarray(voxels.counts[None]),
        densities=jnp.zeros(0),
        bone=jnp.asarray(samples.bone),
    )
    return _with_densities(surface, coordinates, None)


def _thickness(widths: Float[np.ndarray, "N"], chart: Chart, width: float) -> Float[np.ndarray, "N"]:
    """Compute the thickness with which a primitive alone contains its whole voxel within the level.

    In the paper the influence ends at half a voxel's width. Then no corner of a voxel is within the level,
    and samples that the surface was made of are forbidden.
    """
    return np.sqrt(chart.dimension) * widths / 2 + (LEVEL - 1) / STIFFNESS * width / 2


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
