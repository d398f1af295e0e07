"""Mesh decimation of bodies, with transfer of shape and skin."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..arguments import checked
from ..geometry.attachment import attach_points
from ..geometry.mesh import area_normals, triangle_sides
from .body import Body
from .body_model import BodyModel
from .skin.interpolate import interpolate

#: number of vertices of the smallest closed surface, a tetrahedron
MIN_VERTICES = 4


@checked
def reduce_body(body: Body, vertices: int) -> Body:
    """Reduce a body to about `vertices` vertices; the skeleton stays as it is.

    The surface is decimated by quadric errors (Garland and Heckbert 1997, as implemented by
    `fast_simplification`). This preserves its volume and keeps a closed surface closed. The skin is
    interpolated at the nearest points of the full surface (`AbstractSkin.transfer`). The result is
    deterministic. A body with no more vertices than asked for is returned unchanged.

    **Raises:** `InputError` with one sentence when fewer than 4 vertices are asked for, or when the surface
    cannot be reduced so far.
    """
    if vertices < MIN_VERTICES:
        raise ValueError(f"A body cannot be reduced to {vertices} vertices; ask for {MIN_VERTICES} or more.")
    if len(body.vertices) <= vertices:
        return body
    shape, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    points, triangles = decimate(shape, faces, vertices)
    hold = attach_points(points, shape, faces)
    return Body(
        body.skeleton,
        body.skin.transfer(hold.corners, hold.barycentric, body.skeleton),
        jnp.asarray(points, body.vertices.dtype),
        jnp.asarray(triangles, body.faces.dtype),
    )


@checked
def reduce_model(model: BodyModel, vertices: int) -> BodyModel:
    """Reduce a body model to about `vertices` vertices, with the template of `reduce_body`.

    **Raises:** `InputError` as `reduce_body` does.
    """
    template = reduce_body(model.template, vertices)
    if template is model.template:
        return model
    whole = np.asarray(model.template.vertices, float), np.asarray(model.template.faces)
    hold = attach_points(np.asarray(template.vertices, float), *whole)
    by_shape = np.moveaxis(np.asarray(model.modes.vertices, float), 0, 1)
    carried = interpolate(by_shape.reshape(len(by_shape), -1), hold.corners, hold.barycentric)
    modes = np.moveaxis(carried.reshape(len(carried), -1, 3), 1, 0)
    return eqx.tree_at(
        lambda m: (m.template, m.modes.vertices),
        model,
        (template, jnp.asarray(modes, model.modes.vertices.dtype)),
    )


def decimate(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], num_vertices: int
) -> tuple[Float[np.ndarray, "N 3"], Int[np.ndarray, "G 3"]]:
    """Decimate a surface to about `num_vertices` vertices, without unused vertices or degenerate triangles.

    **Raises:** `ValueError` with one sentence when the surface cannot be reduced so far.
    """
    closed, present = _is_closed(faces), len(np.unique(faces))
    # an edge collapse removes one vertex and two triangles in the interior, fewer triangles at the border
    target = (
        len(faces) - 2 * (present - num_vertices) if closed else round(len(faces) * num_vertices / present)
    )
    target = max(target, MIN_VERTICES)
    best = None
    # the least aggressive collapse that suffices: others distort the shape and may open a closed surface
    for haste in (3.0, 4.0, 5.0, 6.0, 7.0):
        points, triangles = _remove_degenerate(*_collapse_edges(vertices, faces, target, haste))
        if len(triangles) and _is_closed(triangles) >= closed:
            best = points, triangles
            if len(triangles) <= 1.02 * target + 2:
                return best
    found = "no" if best is None else f"{len(best[0])}"
    raise ValueError(
        f"A surface of {present} vertices could not be decimated to {num_vertices}; the smallest result has {found} "
        "vertices; ask for more vertices."
    )


def _collapse_edges(
    vertices: np.ndarray, faces: np.ndarray, target: int, aggressiveness: float
) -> tuple[np.ndarray, np.ndarray]:
    """Collapse edges until `target` triangles are left, or as few as `aggressiveness` allows."""
    import fast_simplification  # imported here, as most programs never decimate

    # repeated halving recomputes the quadric errors, which preserves the volume better than one pass
    while len(faces) > target:
        before = len(faces)
        # fast_simplification takes writable arrays in C order only
        vertices, faces = fast_simplification.simplify(
            np.array(vertices, float),
            np.array(faces, np.int32),
            target_count=max(target, before // 2),
            agg=aggressiveness,
        )[:2]
        if len(faces) in (0, before):
            break
    return np.asarray(vertices, float), np.asarray(faces)


def _is_closed(faces: np.ndarray) -> bool:
    """Test that every edge has exactly two triangles, once in each direction."""
    edges = triangle_sides(faces)
    if len(np.unique(edges, axis=0)) < len(edges):
        return False
    return np.array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))


def _remove_degenerate(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Remove degenerate triangles, then unused vertices."""
    triangles = triangles[np.linalg.norm(area_normals(points[triangles]), axis=1) > 0]
    used, inverse = np.unique(triangles, return_inverse=True)
    return points[used], inverse.reshape(-1, 3)
