"""Evidence against a pose in a cloud: points without surface, surface without points, self-intersection."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.body import pose_body
from ...body.pose import Pose
from ...geometry.camera import Camera, is_in_image, project_points
from ...observe.clouds import Cloud
from ...small_matrices import apply_small
from .region_samples import MIN_DISTANCE, STRIDE, RegionSamples
from .self_penetration import inside_degrees

#: points sampled from a cloud
NUM_POINTS = 1536
#: samples compared with all points in one pass
BLOCK = 32
#: directions from which unknown sensors may look
NUM_DIRECTIONS = 32
#: least cosine between a point's normal and that of the surface that explains it
MIN_NORMAL_COSINE = 0.5
#: distances, as shares of the body's size, at which a point begins to count as unexplained and at which it
#: counts fully (4 and 8 cm of a person), and distance from all points beyond which a sample is empty
NEAR, FAR, EMPTY = 0.023, 0.046, 0.045
#: a sample is empty beyond this multiple of the distance of neighbours in a cloud spread over a person
SPARSE = 1.1
#: side of the cells in which points are counted, as a share of the body's size, and cells along a side of the
#: grid, which wraps around; unexplained points a quarter as dense as those of the surface count fully
CELL_SIZE, NUM_CELLS, FULL_DENSITY = 0.04, 32, 0.25
#: least cosine between the surface and the line of sight; samples more than `OCCLUSION_DEPTH` behind another in the same
#: cell of `DEPTH_CELL_SIZE` are occluded, as shares of the body's size
MIN_SIGHT_COSINE, DEPTH_CELL_SIZE, OCCLUSION_DEPTH = 0.6, 0.035, 0.05
#: least cosine for the coverage of a direction; directions of unknown sensors are those with a coverage
#: within `COVERAGE_TOLERANCE` of the best one's
MIN_COVERAGE_COSINE, COVERAGE_TOLERANCE = 0.1, 0.03
#: replaces a count of zero points
TINY = 1e-9
#: cells along a side of a depth buffer, which wraps around
NUM_DEPTH_CELLS = 64
#: the direction of an unknown sensor differs from the nearest known direction: sideways shift of an occluder for each metre
#: in front of the body, and stride of the occluders, which are repeated with these shifts
SHIFT, OCCLUDER_STRIDE = 0.15, 4


class Evidence(eqx.Module):
    """Measurements of one frame, by the R regions of a body, and by the D directions that it may be seen
    from.
    """

    #: share of the cloud's points that are nearest to each region and that no part explains
    unexplained: Float[Array, "*frames R"]
    #: share of the body's area that belongs to each region, is in view of the sensors and has no points
    empty: Float[Array, "*frames R"]
    #: share of the body's area that belongs to each region and lies within another part
    inside: Float[Array, "*frames R"]
    #: number of points explained by each of the P moving parts, relative to the number expected from its area
    #: for uniform visibility
    support: Float[Array, "*frames P"]
    #: share of the surface visible from each direction that has points
    coverage: Float[Array, "*frames D"]


@eqx.filter_jit
def gather_evidence(
    surface: RegionSamples,
    pose: Pose,
    cloud: Cloud,
    sensors: Float[Array, "D"] | Sequence[Camera] = (),
    occluders: Float[Array, "O 4"] | None = None,
    allowance: Float[Array, "J"] | None = None,
) -> Evidence:
    """Measure the disagreement of a pose and a cloud, and the self-intersection of the body.

    All measurements use a thinned cloud and the samples of the surface.

    **Arguments:** `sensors` are the cameras where they are known. Otherwise `NUM_DIRECTIONS` spread over the
    sphere represent possible sensors: the array is one for each direction of a sensor (`sensor_directions`) and zero
    for the others. Where it is empty or zero, the directions of this frame that show the least empty surface
    are used. `occluders` are points of other surfaces that hide the body, such as other people's, metres, each with a
    fourth number that is one, or zero for none. `allowance` is the distance from the skin of each joint's part up to which its
    clothes explain points, metres (`clothes_allowance`); there are no clothes where it is not given.
    """
    posed = pose_body(surface.body, pose)
    turned = apply_small(posed.transforms.rotations[surface.bones], surface.normals)
    normals = turned / jnp.linalg.norm(turned, axis=1, keepdims=True)
    size = surface.size * pose.scale
    rows, weights = _sample_points(cloud)
    points, point_normals = cloud.points[rows], cloud.normals[rows]
    # relative to the body's centre, as differences of squares lose digits far from the origin
    middle = jnp.mean(posed.vertices, 0)
    vertices, points = posed.vertices - middle, points - middle
    before = jnp.zeros((0, 4), vertices.dtype) if occluders is None else occluders
    hiding = before - jnp.append(middle, 0.0)
    nearest = _nearest_samples(points, point_normals, weights > 0, vertices, normals)
    to_skin, compatible, region_sample = jnp.sqrt(nearest.squared), nearest.compatible, nearest.sample
    distances, beyond_skin = to_skin, 0.0
    if allowance is not None:
        beyond_skin = allowance[surface.bones]
        wearing, squared = _nearest_clothes(points, point_normals, vertices, normals, beyond_skin)
        to_clothes = jnp.maximum(jnp.sqrt(squared) - beyond_skin[wearing], 0.0)
        # also points beyond the clothes belong to what these cover, and not to a hand that is nearer
        worn = (to_skin > NEAR * size) & (beyond_skin[wearing] > 0)
        distances = jnp.where(worn, jnp.minimum(to_skin, to_clothes), to_skin)
        compatible = jnp.where(worn, wearing, compatible)
        region_sample = jnp.where(worn, wearing, region_sample)
    distances = distances / size
    region = surface.regions[region_sample]
    beyond = jnp.clip((distances - NEAR) / (FAR - NEAR), 0.0, 1.0)
    amount = weights * beyond * _neighbour_density(points / (CELL_SIZE * size), rows, beyond)
    count = len(surface.names)
    # gaps are wide between few points
    gap = jnp.maximum(EMPTY, SPARSE / jnp.sqrt(jnp.maximum(jnp.sum(cloud.weights > 0), 1))) * size
    covered = nearest.to_points <= (gap + beyond_skin) ** 2
    if isinstance(sensors, Sequence) and len(sensors):
        expected = jnp.stack(
            [_visible_in_camera(camera, posed.vertices, normals, size, before) for camera in sensors]
        )
        share = _coverage(expected, covered)
        expected = jnp.any(expected, 0)
    else:
        directions = jnp.asarray(_fibonacci_directions(NUM_DIRECTIONS), vertices.dtype)
        cosine = (normals @ directions.T).T
        clear = _visible_from(directions, vertices, size, hiding)
        # at grazing angles the coverage falls steeply with the angle to the next sensor
        share = _coverage(clear & (cosine > MIN_COVERAGE_COSINE), covered)
        selected = share >= jnp.max(share) - COVERAGE_TOLERANCE
        if len(sensors):
            selected = jnp.where(jnp.any(jnp.asarray(sensors) > 0), jnp.asarray(sensors) > 0, selected)
        facing = (cosine > MIN_SIGHT_COSINE) & selected[:, None]
        # the direction of a sensor is approximate: a sample occluded from any direction nearby may be
        # occluded
        expected = jnp.any(facing, 0) & ~jnp.any(facing & ~clear, 0)
    few = slice(None, None, STRIDE)
    square = STRIDE * surface.area * pose.scale**2
    inside = surface.outside_at_rest * inside_degrees(
        vertices[few],
        normals[few],
        square * surface.areas[few],
        surface.regions[few],
        surface.non_adjacent,
        MIN_DISTANCE * size,
    )
    parts = jnp.asarray(surface.region_parts)[surface.regions]
    of_parts = jnp.zeros(len(surface.joints), amount.dtype).at[parts].add(surface.areas)
    explained = jnp.zeros_like(of_parts).at[parts[compatible]].add(weights * (distances < NEAR))
    areas = surface.areas[:, None] * (surface.regions[:, None] == jnp.arange(count))
    return Evidence(
        unexplained=jnp.zeros(count, amount.dtype).at[region].add(amount),
        inside=STRIDE * inside @ areas[few],
        empty=(expected & ~covered).astype(areas.dtype) @ areas,
        support=explained / jnp.maximum(jnp.sum(explained) * of_parts, TINY),
        coverage=share,
    )


class _NearestSamples(eqx.Module):
    """The nearest samples of points, and the nearest points of samples."""

    #: nearest sample, whatever its normal
    sample: Int[Array, "N"]
    #: nearest sample with a compatible normal, the first where there is none, and its squared distance
    compatible: Int[Array, "N"]
    squared: Float[Array, "N"]
    #: squared distance from each sample to the nearest of the used points with a compatible normal
    to_points: Float[Array, "S"]


def _nearest_samples(
    points: Float[Array, "N 3"],
    point_normals: Float[Array, "N 3"],
    used: Bool[Array, "N"],
    vertices: Float[Array, "S 3"],
    normals: Float[Array, "S 3"],
) -> _NearestSamples:
    """Search by a running minimum over blocks of samples, which XLA vectorises on a CPU, unlike `argmin` of all distances."""
    count, extra = len(vertices), -len(vertices) % BLOCK
    known = jnp.any(point_normals != 0, 1)
    limits = jnp.where(known, MIN_NORMAL_COSINE, -jnp.inf).astype(points.dtype)
    away = jnp.where(used, 0.0, jnp.inf).astype(points.dtype)

    def first_of(values, least, numbers):
        return jnp.min(jnp.where(values == least, numbers, count), 0)

    def step(found, rows):
        best, sample, best_compatible, compatible = found
        block, block_normals, first = rows
        squared = sum((points[:, axis] - block[:, axis, None]) ** 2 for axis in range(3))
        squared = jnp.where(squared < jnp.inf, squared, jnp.inf)  # also where it is not a number
        cosine = sum(point_normals[:, axis] * block_normals[:, axis, None] for axis in range(3))
        near = jnp.where(cosine > limits, squared, jnp.inf)
        least, least_near = jnp.min(squared, 0), jnp.min(near, 0)
        closer, closer_compatible = least < best, least_near < best_compatible
        numbers = (first + jnp.arange(BLOCK, dtype=jnp.int32))[:, None]
        found = (
            jnp.where(closer, least, best),
            jnp.where(closer, first_of(squared, least, numbers), sample),
            jnp.where(closer_compatible, least_near, best_compatible),
            jnp.where(closer_compatible, first_of(near, least_near, numbers), compatible),
        )
        return found, jnp.min(near + away, 1)

    far, none = jnp.full(len(points), jnp.inf, points.dtype), jnp.zeros(len(points), jnp.int32)
    rows = (
        jnp.pad(vertices, ((0, extra), (0, 0)), constant_values=jnp.inf).reshape(-1, BLOCK, 3),
        jnp.pad(normals, ((0, extra), (0, 0))).reshape(-1, BLOCK, 3),
        jnp.arange(0, count + extra, BLOCK, dtype=jnp.int32),
    )
    (_, sample, squared, compatible), to_points = jax.lax.scan(step, (far, none, far, none), rows)
    return _NearestSamples(sample, compatible, squared, to_points.reshape(-1)[:count])


def _nearest_clothes(
    points: Float[Array, "N 3"],
    point_normals: Float[Array, "N 3"],
    vertices: Float[Array, "S 3"],
    normals: Float[Array, "S 3"],
    beyond_skin: Float[Array, "S"],
) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """Find the sample whose clothes explain each point best, by the squared distance minus that of the clothes; and the
    squared distance to it, infinite where no sample has a compatible normal.
    """
    squared = jnp.sum((points[:, None] - vertices) ** 2, -1)
    known = jnp.any(point_normals != 0, 1)[:, None]
    fits = ~known | (point_normals @ normals.T > MIN_NORMAL_COSINE)
    squared = jnp.where(fits, squared, jnp.inf)
    best = jnp.argmin(squared - beyond_skin**2, 1)
    return best, jnp.take_along_axis(squared, best[:, None], 1)[:, 0]


def _coverage(shown: Bool[Array, "D S"], covered: Bool[Array, "S"]) -> Float[Array, "D"]:
    """Compute the share of the samples visible from each direction that have points."""
    return jnp.sum(shown & covered, 1) / jnp.maximum(jnp.sum(shown, 1), 1)


def _sample_points(cloud: Cloud) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """Select rows of points at equal steps of weight, and equal weights; zero for an empty cloud."""
    passed = jnp.cumsum(cloud.weights)
    total = passed[-1]
    steps = (jnp.arange(NUM_POINTS, dtype=passed.dtype) + 0.5) / NUM_POINTS * total
    rows = jnp.minimum(jnp.searchsorted(passed, steps), len(passed) - 1)
    weights = jnp.where(total > 0, jnp.full(NUM_POINTS, 1.0 / NUM_POINTS, passed.dtype), 0.0)
    return rows, weights


def _neighbour_density(
    cells: Float[Array, "N 3"], rows: Int[Array, "N"], beyond: Float[Array, "N"]
) -> Float[Array, "N"]:
    """Compute the density of each point's unexplained neighbours, relative to that of a surface; isolated
    points are zero.

    `cells` are the points in units of a cell; a point may be repeated, as the rising `rows` show.
    """
    times = jnp.searchsorted(rows, rows, side="right") - jnp.searchsorted(rows, rows)
    column = jnp.mod(jnp.floor(cells), NUM_CELLS).astype(jnp.int32)
    cell = (column[:, 0] * NUM_CELLS + column[:, 1]) * NUM_CELLS + column[:, 2]
    empty = jnp.zeros(NUM_CELLS**3, beyond.dtype)
    surface = empty.at[cell].add(1.0)[cell] - times
    usual = jnp.nanmedian(jnp.where(beyond == 0, surface, jnp.nan))
    others = empty.at[cell].add(beyond)[cell] - times * beyond
    enough = jnp.maximum(FULL_DENSITY * jnp.where(jnp.isfinite(usual), usual, 0.0), times)
    return jnp.clip(others / enough, 0.0, 1.0)


def _fibonacci_directions(count: int) -> Float[np.ndarray, "D 3"]:
    """Make unit directions spread evenly over the sphere (a Fibonacci lattice)."""
    steps = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * steps / count), np.pi * (1 + 5**0.5) * steps
    return np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], 1)


def _visible_from(
    directions: Float[Array, "D 3"],
    vertices: Float[Array, "S 3"],
    size: Float[Array, ""],
    occluders: Float[Array, "O 4"],
) -> Bool[Array, "D S"]:
    """Find the samples that are not occluded from a distant camera in each direction."""
    helper = jnp.where(jnp.abs(directions[:, 1:2]) < 0.9, jnp.eye(3)[1], jnp.eye(3)[0])
    across = jnp.cross(helper, directions)
    across = across / jnp.linalg.norm(across, axis=1, keepdims=True)
    up = jnp.cross(directions, across)

    def project(points):
        return jnp.stack([points @ across.T, points @ up.T], -1) / (DEPTH_CELL_SIZE * size)

    few = occluders[::OCCLUDER_STRIDE]
    steps = SHIFT / (DEPTH_CELL_SIZE * size) * jnp.asarray(np.indices((3, 3)).reshape(2, 1, -1).T - 1.0)

    def from_one(cells, nearness, hiding_cells, ahead):
        shifted = (hiding_cells + steps * jnp.maximum(ahead, 0.0)[:, None]).reshape(-1, 2)
        hiding = shifted, jnp.tile(ahead, len(steps)), jnp.tile(few[:, 3] > 0, len(steps))
        return _unoccluded(cells, nearness, OCCLUSION_DEPTH * size, hiding)

    ahead = few[:, :3] @ directions.T
    return jax.vmap(from_one, (1, 1, 1, 1))(
        project(vertices), vertices @ directions.T, project(few[:, :3]), ahead
    )


def _visible_in_camera(
    camera: Camera,
    vertices: Float[Array, "S 3"],
    normals: Float[Array, "S 3"],
    size,
    occluders: Float[Array, "O 4"],
) -> Bool[Array, "S"]:
    """Find the samples that a camera sees."""
    sight = camera.eye - vertices
    sight = sight / jnp.linalg.norm(sight, axis=1, keepdims=True)
    pixels, depth = project_points(camera, vertices)
    # a cell is as wide as `DEPTH_CELL_SIZE` in the depth of the body's centre
    wide = DEPTH_CELL_SIZE * size * jnp.mean(camera.focal) / jnp.maximum(jnp.median(depth), 1e-3)
    hiding_pixels, hiding_depth = project_points(camera, occluders[:, :3])
    ahead = (occluders[:, 3] > 0) & (hiding_depth > 0)
    hiding = (hiding_pixels / wide, -hiding_depth, ahead)
    clear = _unoccluded(pixels / wide, -depth, OCCLUSION_DEPTH * size, hiding)
    return clear & is_in_image(camera, vertices) & (jnp.sum(sight * normals, 1) > MIN_SIGHT_COSINE)


def _unoccluded(
    positions: Float[Array, "S 2"],
    nearness: Float[Array, "S"],
    tolerance: Float[Array, ""],
    hiding: tuple[Float[Array, "O 2"], Float[Array, "O"], Bool[Array, "O"]],
) -> Bool[Array, "S"]:
    """Find the samples without another one, or a point of another surface, in their cell that is nearer by more than
    `tolerance`.

    `hiding` are positions and nearness of the other surface's points, and whether they count.
    """

    def cell_of(positions):
        column, row = (
            jnp.mod(jnp.floor(positions[:, axis]), NUM_DEPTH_CELLS).astype(jnp.int32) for axis in (0, 1)
        )
        return row * NUM_DEPTH_CELLS + column

    cell = cell_of(positions)
    nearest = jnp.full(NUM_DEPTH_CELLS * NUM_DEPTH_CELLS, -jnp.inf, nearness.dtype).at[cell].max(nearness)
    other, other_nearness, counts = hiding
    if len(other):
        # the cells wrap around, so that distant points would hide the body as well
        low, high = jnp.min(positions, 0), jnp.max(positions, 0)
        counts = counts & jnp.all((other >= low - 1.0) & (other <= high + 1.0), 1)
        nearest = nearest.at[cell_of(other)].max(jnp.where(counts, other_nearness, -jnp.inf))
    return nearness >= nearest[cell] - tolerance
