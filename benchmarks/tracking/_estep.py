"""A test scene of the E-step, and a brute-force reference with one argmin per part."""

import functools
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.fit.correspondence.part_blocks import PartBlocks, make_part_blocks
from jaxcap.geometry.mesh import vertex_normals
from jaxcap.observe.clouds import Cloud


def make_scene(
    path: Path, num_vertices: int = 5000, num_points: int = 5000, noise: float = 0.005, seed: int = 0
):
    """Make a decimated human and a noisy cloud sampled on it, with 10 % of outliers.

    Returns `(parts, vertices, normals, cloud)`, float32.
    """
    import fast_simplification
    from scipy.spatial import cKDTree

    rng = np.random.default_rng(seed)
    data = np.load(path, allow_pickle=False)
    share = 1 - num_vertices / len(data["vertices"])
    vertices, faces = fast_simplification.simplify(data["vertices"], data["faces"], share)
    nearest = cKDTree(data["vertices"]).query(vertices)[1]
    bones = data["weights"][nearest].argmax(1)
    vertices, faces = vertices.astype(np.float32), faces.astype(np.int32)
    normals = np.asarray(vertex_normals(jnp.asarray(vertices), jnp.asarray(faces)))
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(cross, axis=1)
    chosen = rng.choice(len(faces), num_points, p=area / area.sum())
    mix = rng.dirichlet(np.ones(3), num_points)
    points = np.einsum("nc,ncx->nx", mix, corners[chosen]) + rng.normal(size=(num_points, 3)) * noise
    directions = cross[chosen] / area[chosen, None]
    outliers = rng.random(num_points) < 0.1
    low, high = vertices.min(0) - 0.2, vertices.max(0) + 0.2
    points[outliers] = rng.uniform(low, high, (outliers.sum(), 3))
    cloud = Cloud(
        jnp.asarray(points, jnp.float32),
        jnp.asarray(directions, jnp.float32),
        jnp.ones(num_points, jnp.float32),
    )
    parts = make_part_blocks(bones, data["weights"].shape[1], vertices)
    return parts, jnp.asarray(vertices), jnp.asarray(normals), cloud


def part_members(parts: PartBlocks) -> tuple[tuple[int, ...], ...]:
    """List the vertices of each part, as a static argument of `brute_force_posterior`."""
    slots = np.asarray(parts.slots)
    ends = np.cumsum(parts.blocks_of_part)
    counts = zip(parts.blocks_of_part, ends, strict=True)
    return tuple(tuple(np.unique(slots[end - count : end]).tolist()) for count, end in counts)


@functools.partial(jax.jit, static_argnames=("members", "chunk"))
def brute_force_posterior(
    vertices, normals, cloud, sigma, *, members, normal_threshold, outlier, box_volume, chunk: int = 250
):
    """Dense posterior `(N, K + 1)` and vertices `(N, K)`: two products and one masked argmin a part."""
    present = [part for part in members if part]
    layout = [(vertices[jnp.array(part)], normals[jnp.array(part)], jnp.array(part)) for part in present]

    def some(pair):
        points, directions = pair
        distances, nearest = [], []
        for part_vertices, part_normals, index in layout:
            squared = (
                jnp.sum(points**2, 1)[:, None] - 2 * points @ part_vertices.T + jnp.sum(part_vertices**2, 1)
            )
            squared = jnp.where(directions @ part_normals.T > normal_threshold, squared, jnp.inf)
            best = jnp.argmin(squared, 1)
            distances.append(jnp.take_along_axis(squared, best[:, None], 1)[:, 0])
            nearest.append(index[best])
        squared = jnp.stack(distances, 1)
        shift = jnp.log((1 - outlier) / len(present)) - 1.5 * jnp.log(2 * jnp.pi * sigma**2)
        logs = shift - squared / (2 * sigma**2)
        none = jnp.full((len(points), 1), jnp.log(outlier / box_volume))
        return jax.nn.softmax(jnp.concatenate([logs, none], 1), 1), jnp.stack(nearest, 1)

    pieces = (cloud.points.reshape(-1, chunk, 3), cloud.normals.reshape(-1, chunk, 3))
    weights, nearest = jax.lax.map(some, pieces)
    return weights.reshape(-1, weights.shape[-1]), nearest.reshape(-1, nearest.shape[-1])


def median_time(function, *arguments, repeats: int = 30, **settings) -> float:
    """Measure the median seconds of a compiled call."""
    jax.block_until_ready(function(*arguments, **settings))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments, **settings))
        times.append(time.perf_counter() - start)
    return float(np.median(times))
