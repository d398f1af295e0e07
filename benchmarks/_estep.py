"""The E-step's test scene and its rival: one plain argmin a part."""

import functools
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from jaxcap.fit.parts import Parts, make_parts
from jaxcap.geometry.mesh import vertex_normals
from jaxcap.observe import Cloud


def make_scene(
    path: Path, num_vertices: int = 5000, num_points: int = 5000, noise: float = 0.005, seed: int = 0
):
    """A decimated human and a noisy cloud sampled on it with one outlier in ten.

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
    parts = make_parts(bones, data["weights"].shape[1], vertices)
    return parts, jnp.asarray(vertices), jnp.asarray(normals), cloud


def brute_force_arguments(parts: Parts, vertices, normals):
    """Vertices and normals padded to the largest part, `(K, M, 3)`, with their indices `(K, M)`."""
    slots = np.asarray(parts.slots)
    ends = np.cumsum(parts.blocks_of_part)
    members = [np.unique(slots[e - c : e]) for c, e in zip(parts.blocks_of_part, ends, strict=True)]
    largest = max(map(len, members))
    index = np.stack([np.pad(m, (0, largest - len(m)), constant_values=-1) for m in members])
    return vertices, normals, jnp.asarray(index)


@functools.partial(jax.jit, static_argnames="chunk")
def brute_force_posterior(
    vertices, normals, index, cloud, sigma, *, normal_threshold, outlier, box_volume, chunk: int = 250
):
    """Dense posterior `(N, K + 1)` and vertices `(N, K)` by one matmul and one masked argmin a part."""
    here = index >= 0
    part_vertices, part_normals = vertices[index], normals[index]
    uniform = jnp.any(here, 1) / jnp.sum(jnp.any(here, 1))

    def one(point, normal):
        squared = jnp.sum((part_vertices - point) ** 2, -1)
        compatible = here & (part_normals @ normal > normal_threshold)
        squared = jnp.where(compatible, squared, jnp.inf)
        nearest = jnp.argmin(squared, 1)
        found = jnp.take_along_axis(squared, nearest[:, None], 1)[:, 0]
        log_parts = (
            jnp.log((1 - outlier) * uniform) - 1.5 * jnp.log(2 * jnp.pi * sigma**2) - found / (2 * sigma**2)
        )
        logs = jnp.append(log_parts, jnp.log(outlier / box_volume))
        return jax.nn.softmax(logs), jnp.take_along_axis(index, nearest[:, None], 1)[:, 0]

    return jax.lax.map(lambda pair: one(*pair), (cloud.points, cloud.normals), batch_size=chunk)


def median_time(function, *arguments, repeats: int = 30, **settings) -> float:
    """Median seconds of a call, compiled before."""
    jax.block_until_ready(function(*arguments, **settings))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(function(*arguments, **settings))
        times.append(time.perf_counter() - start)
    return float(np.median(times))
