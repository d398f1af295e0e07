"""A body as a soft object: an implicit surface of ellipsoids fixed to bones, fitted to points."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...arguments import check_fields, checked
from ...body.body import Body, Posed
from ...geometry.linear import inverse_symmetric
from ...geometry.mesh import vertex_areas
from ...small_matrices import apply_small, multiply_small
from ..energy import AbstractEnergy, safe_sqrt

#: share of an ellipsoid's size around its centre in which the cone of distances is rounded off
ROUNDING = 0.1


class SoftObject(eqx.Module):
    """Exponential primitives fixed to bones, whose sum has the skin as a level set (Plaenkers and Fua 2003;
    joint-limits paper, section 5.1).

    Primitive `i` is the ellipsoid `d_i(y) = (y - c)^T Q (y - c) = 1` in the rest frame of the world, with the
    axes' directions and `1 / semi-axis^2` as the eigenvectors and eigenvalues of its precision `Q`. Its field
    is `exp(-stiffness * phi_i)`, of the distance `phi_i` from it in metres (`primitive_distance`), and the
    skin is where the sum of the fields is 1: for one primitive exactly its ellipsoid, for several their
    blend. The paper's primitives are exponentials of `d_i` itself, whose reach grows with their size. With
    distances in metres one stiffness blends fingers and trunk alike.
    """

    #: bone of each primitive
    bones: Int[Array, "P"]
    #: rest frame of the world, metres
    centres: Float[Array, "P 3"]
    #: symmetric and positive, per metre squared
    precisions: Float[Array, "P 3 3"]
    #: per metre: primitives blend if nearer to each other than about its inverse
    stiffness: Float[Array, ""]

    def __check_init__(self):
        check_fields(self)


class SoftPoints(AbstractEnergy):
    """`sum_i w_i rho(D(x_i))^2` over observed points, with their distances `D` from a soft object's skin
    (joint-limits paper, eq. 4), metres.

    A weight of zero marks a missing point, whatever its position.

    `rho(D) = D / sqrt(1 + (D / robust)^2)` is `D` near the skin and saturates at `robust` metres (Geman and
    McClure 1987), so that outliers lose their influence; with infinity it never saturates.
    """

    soft: SoftObject
    points: Float[Array, "N 3"]
    weights: Float[Array, "N"]
    robust: Float[Array, ""] = eqx.field(default=np.inf, converter=jnp.asarray)

    def residual(self, posed: Posed):
        # depth images have NaN where nothing was observed
        points = jnp.where((self.weights > 0)[:, None], self.points, 0.0)
        distances = soft_distance(self.soft, posed, points)
        return safe_sqrt(self.weights) * distances / jnp.sqrt(1.0 + (distances / self.robust) ** 2)


@checked
def soft_distance(soft: SoftObject, posed: Posed, points: Float[Array, "N 3"]) -> Float[Array, "N"]:
    """Compute the signed distance of points from the posed skin, metres, negative inside.

    With `F = sum_i exp(-k phi_i)` it is `-log(F) / k`, the smooth minimum of the primitives' distances: zero
    on the skin, and below the least distance by at most `log(P) / k`. Its gradient is the mean of theirs by
    shares of F, so it stays about one. `(1 - F) / |grad F|` has the same zeros and slope there, but grows
    exponentially outside, and has poles inside, where fields balance.

    The P primitives are transformed into the world by similarities, not N points into the frame of each.
    """
    return _blend(points, *_posed_primitives(soft, posed))


def soft_distance_slopes(
    soft: SoftObject, posed: Posed, points: Float[Array, "N 3"]
) -> tuple[Float[Array, "N"], Float[Array, "N P 3"]]:
    """Compute `soft_distance` and its derivative by the offset of each point from each primitive.

    The sum over primitives is the slope by the point, and the negative sum over the primitives of a bone is that by a translation of
    the bone.
    """
    centres, precisions, stiffness = _posed_primitives(soft, posed)
    measure = jax.vmap(jax.vmap(jax.value_and_grad(primitive_distance)), (0, None))
    distances, along = measure(points[:, None] - centres, precisions)
    shares = jax.nn.softmax(-stiffness * distances, axis=1)
    return -jax.nn.logsumexp(-stiffness * distances, axis=1) / stiffness, shares[..., None] * along


def _posed_primitives(
    soft: SoftObject, posed: Posed
) -> tuple[Float[Array, "P 3"], Float[Array, "P 3 3"], Float[Array, ""]]:
    """Compute centres, precisions and stiffness in the world."""
    r, scale = posed.transforms.rotations[soft.bones], posed.pose.scale
    centres = apply_small(r, soft.centres) + posed.transforms.translations[soft.bones]
    # the inverse of a similarity: its rotation block is a rotation times the scale
    precisions = multiply_small(multiply_small(r, soft.precisions), jnp.swapaxes(r, 1, 2)) / scale**4
    return centres, precisions, soft.stiffness / scale


def primitive_distance(offset: Float[Array, "3"], precision: Float[Array, "3 3"]) -> Float[Array, ""]:
    """Compute the distance `phi` in metres from an ellipsoid of a point at an `offset` from its centre.

    To first order it is `(sqrt(d) - 1) / |grad sqrt(d)|` (Taubin 1991), which is exact along the axes and has
    slope one on the surface, but is not smooth at the centre. With `d + ROUNDING^2` for `d`, and likewise in
    the denominator, it is smooth there too, and has the same zeros.
    """
    gradient = precision @ offset
    length = jnp.sqrt(offset @ gradient + ROUNDING**2)
    slope = jnp.sqrt(gradient @ gradient + ROUNDING**2 * jnp.trace(precision) / 3)
    return (length - (1 + ROUNDING**2) ** 0.5) * length / slope


@jax.custom_jvp
def _blend(points, centres, precisions, stiffness):
    """Compute the smooth minimum over primitives in the world, per point.

    Its derivative is written by hand for forward mode: the slopes of N x P distances are computed once, and
    each tangent is a product with them. With automatic differentiation, every tangent would pass through all
    of the N x P distances.
    """
    differences = points[:, None] - centres
    distances = jax.vmap(jax.vmap(primitive_distance), (0, None))(differences, precisions)
    return -jax.nn.logsumexp(-stiffness * distances, axis=1) / stiffness


@_blend.defjvp
def _blend_tangent(primals, tangents):
    points, centres, precisions, stiffness = primals
    d_points, d_centres, d_precisions, d_stiffness = tangents
    measure = jax.vmap(jax.vmap(jax.value_and_grad(primitive_distance, (0, 1))), (0, None))
    distances, (along, across) = measure(points[:, None] - centres, precisions)
    value = -jax.nn.logsumexp(-stiffness * distances, axis=1) / stiffness
    shares = jax.nn.softmax(-stiffness * distances, axis=1)
    along, across = shares[..., None] * along, shares[..., None, None] * across
    tangent = (
        jnp.sum(jnp.sum(along, 1) * d_points, -1)
        - along.reshape(len(points), -1) @ d_centres.reshape(-1)
        + across.reshape(len(points), -1) @ d_precisions.reshape(-1)
        + (jnp.sum(shares * distances, 1) - value) / stiffness * d_stiffness
    )
    return value, tangent


_measure = jax.jit(_blend)


#: fewest vertices of a slice; fewer define no shape
MIN_VERTICES = 4
#: rounds in which primitives are scaled until the vertices of each lie on the skin
ROUNDS = 20


@checked
def make_soft_object(body: Body, primitives: int = 2, blend: float | None = None) -> SoftObject:
    """Make a soft object that replaces a body's surface; not for use under `jit`.

    Each bone's vertices (`skin.dominant_bones()`) are cut into slices across their longest axis, about as
    long as they are wide, and each slice becomes an ellipsoid of its mean and covariance. All are then scaled
    until the vertices of each lie on the skin on average, weighted by area. Bones with fewer than four
    vertices get none.

    **Arguments:** `primitives` largest number of slices of a bone; `blend` metres, the inverse of the
    stiffness, where not given 0.6 of the median of the primitives' shortest semi-axes.

    **Raises:** `ValueError` where no bone has four vertices, `primitives` is less than one, or `blend` is not
    positive.
    """
    if primitives < 1:
        raise ValueError(f"The limit is {primitives} primitives per bone; expected at least one.")
    if blend is not None and not blend > 0:
        raise ValueError(f"The blend length of the primitives is {blend} m; expected a positive length.")
    vertices = np.asarray(body.vertices, float)
    # negligible for a vertex without triangles
    areas = vertex_areas(vertices, np.asarray(body.faces)) + 1e-12
    parts = np.asarray(body.skin.dominant_bones())
    bones, slices, shapes = [], [], []
    for bone in np.unique(parts):
        for chosen, along in _slices(vertices, areas, np.flatnonzero(parts == bone), primitives):
            bones.append(int(bone))
            slices.append(chosen)
            shapes.append(_shape(vertices[chosen], areas[chosen], along))
    if not bones:
        raise ValueError(
            f"No bone of this body has {MIN_VERTICES} or more vertices, so there is no shape to fit; "
            "give a body with a surface."
        )
    centres = np.array([centre for centre, _ in shapes])
    covariances = np.array([covariance for _, covariance in shapes])
    shortest = np.sqrt(3 * np.linalg.eigvalsh(covariances)[:, 0])
    stiffness = 1.0 / (0.6 * np.median(shortest) if blend is None else blend)
    # the covariance of an ellipsoid's surface is a third of its squared semi-axes
    precisions = inverse_symmetric(3 * covariances)
    precisions = _fit_sizes(vertices, areas, slices, centres, precisions, stiffness)
    dtype = body.vertices.dtype
    return SoftObject(
        jnp.asarray(bones),
        jnp.asarray(centres, dtype),
        jnp.asarray(precisions, dtype),
        jnp.asarray(stiffness, dtype),
    )


def _slices(vertices, areas, rows, max_slices: int):
    """Cut a part into slices: `(vertices, axis)` of each, with the axis as long as the slice is thick."""
    if len(rows) < MIN_VERTICES:
        return []
    x = vertices[rows]
    centre, covariance = _moments(x, areas[rows])
    values, vectors = np.linalg.eigh(covariance)
    along = (x - centre) @ vectors[:, 2]
    # a tube of length l and radius r has variances l^2 / 12 and r^2 / 2
    length, width = np.sqrt(12 * values[2]), np.sqrt(8 * values[1])
    count = int(np.clip(np.round(length / width), 1, max_slices)) if width > 0 else max_slices
    edges = np.linspace(along.min(), along.max(), count + 1)
    slots = np.searchsorted(edges[1:-1], along)
    axis = (edges[1] - edges[0]) * vectors[:, 2] * (count > 1)
    return [(rows[slots == k], axis) for k in range(count) if np.sum(slots == k) >= MIN_VERTICES]


def _moments(x, weights):
    weights = weights / weights.sum()
    centre = weights @ x
    return centre, (x - centre).T @ ((x - centre) * weights[:, None])


def _shape(x, weights, axis):
    """Compute centre and covariance of a slice, lengthened so that it overlaps its neighbours."""
    centre, covariance = _moments(x, weights)
    values, vectors = np.linalg.eigh(covariance + 0.1 * np.outer(axis, axis))
    # a flat slice gets a thickness, because the distance from a disc hardly grows along it
    values = np.maximum(values, 0.04 * values[2] + 1e-12)
    return centre, (vectors * values) @ vectors.T


def _fit_sizes(vertices, areas, slices, centres, precisions, stiffness):
    """Scale precisions until the vertices of each primitive lie on the skin on average.

    Sizes stay between half and double: a primitive buried in others would shrink to nothing.
    """
    chosen = np.concatenate(slices)
    owner = np.repeat(np.arange(len(slices)), [len(one) for one in slices])
    total = np.bincount(owner, areas[chosen])
    radii, sizes = np.linalg.det(precisions) ** (-1 / 6), np.ones(len(slices))
    scaled = precisions
    for _ in range(ROUNDS):
        distances = np.asarray(_measure(vertices[chosen], centres, scaled, stiffness), float)
        outside = np.bincount(owner, areas[chosen] * distances) / total
        sizes = np.clip(sizes + np.clip(outside / radii, -0.2, 0.2), 0.5, 2.0)
        scaled = precisions / sizes[:, None, None] ** 2
    return scaled
