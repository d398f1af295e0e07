"""The surface of a body for judgement: samples of equal areas, in named regions."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ...body.body import Body
from ...body.people.anatomy import BODY_REGIONS, without_side
from ...body.skeleton import Skeleton
from ...geometry.mesh import area_normals, unit_vectors
from ...geometry.sampling import spatial_order
from ...stacking import device_array
from .self_penetration import inside_degrees

_inside_degrees = eqx.filter_jit(inside_degrees)

#: samples of a surface, about 4 cm from each other on a person
NUM_SAMPLES = 1536
#: stride of the samples that are tested for self-intersection, and half their distance, as a share of the
#: body's size
STRIDE, MIN_DISTANCE = 2, 0.016
#: joints of a person's parts that are judged by themselves, without their side: the same for every build, so that nothing is
#: compiled again for another person
PERSON_PARTS = frozenset(
    ("Hips", "LowerBack", "Spine", "Spine1", "Head", "Arm", "ForeArm", "FingerBase", "UpLeg", "Leg", "Foot")
)
#: parts of another body with a smaller share of the area are judged together with their parent
MIN_AREA = 0.012
_SIDES = {"Left": "left", "Right": "right", "L": "left", "R": "right"}


class RegionSamples(eqx.Module):
    """Samples of a body's surface with their regions; all data of a body for judgement."""

    #: the samples as vertices, without faces
    body: Body
    #: of the samples at rest, unit
    normals: Float[Array, "S 3"]
    #: the bone with the largest weight of each sample
    bones: Int[Array, "S"]
    #: share of the surface's area that each sample represents, one in sum
    areas: Float[Array, "S"]
    #: region of each sample
    regions: Int[Array, "S"]
    #: one for regions that are not adjacent, which must not lie within each other, and zero for the others
    non_adjacent: Float[Array, "R R"]
    #: degree, zero to one, to which each sample tested for self-intersection is outside of the regions that
    #: are not adjacent to its own, at rest
    outside_at_rest: Float[Array, "W"]
    #: of the surface at rest, square metres
    area: Float[Array, ""]
    #: longest side of the box around the body at rest, metres
    size: Float[Array, ""]
    #: of the regions, for sentences; several regions may have one name
    names: tuple[str, ...] = eqx.field(static=True)
    #: the P joints that move regions; for a region of a fixed joint its nearest ancestor that is not fixed
    joints: tuple[str, ...] = eqx.field(static=True)
    #: index among these of each region's joint
    region_parts: tuple[int, ...] = eqx.field(static=True)
    #: index among these of each joint's nearest ancestor, minus one for a root
    part_parents: tuple[int, ...] = eqx.field(static=True)


def sample_regions(body: Body, joints: Sequence[int] | None = None) -> RegionSamples:
    """Sample the surface of a body evenly, and divide it into regions: its parts, the smallest joined to
    their parents.

    The same body always gives the same samples. Made once, in NumPy.

    **Arguments:** `joints` of `region_joints` of a body with the same skeleton and another shape, so that both
    have the same regions, and nothing is compiled again for the other shape.
    """
    vertices, faces = np.asarray(body.vertices, float), np.asarray(body.faces)
    corners, shares = _even_samples(vertices, faces)
    bones = _sampled_bones(body, corners, shares)
    joints = _large_parts(body.skeleton, bones) if joints is None else joints
    regions = _regions(body.skeleton, joints)[bones]
    names = tuple(region_name(body.skeleton.names[joint]) for joint in joints)
    ancestors = body.skeleton.moving_ancestors
    movers = [ancestors[joint] for joint in joints]
    moving = sorted(set(movers))
    dtype = body.vertices.dtype
    triangles = vertices[corners]
    normals = unit_vectors(area_normals(triangles))
    points = np.einsum("sk,ska->sa", shares, triangles)
    samples = Body(
        body.skeleton,
        body.skin.transfer(corners, shares, body.skeleton),
        device_array(points, dtype),
        device_array(np.zeros((0, 3)), body.faces.dtype),
    )
    size, area = (
        np.ptp(vertices, axis=0).max(),
        0.5 * np.linalg.norm(area_normals(vertices[faces]), axis=1).sum(),
    )
    non_adjacent = device_array(~_adjacent_regions(body.skeleton.parents, joints, names), dtype)
    few = slice(None, None, STRIDE)
    at_rest = (device_array(points[few] - points.mean(0), dtype), device_array(normals[few], dtype))
    areas = device_array(np.full(len(bones[few]), area / len(bones[few])), dtype)
    within = _inside_degrees(
        *at_rest, areas, device_array(regions[few]), non_adjacent, device_array(MIN_DISTANCE * size, dtype)
    )
    return RegionSamples(
        body=samples,
        normals=device_array(normals, dtype),
        bones=device_array(bones),
        areas=device_array(np.full(len(bones), 1.0 / len(bones)), dtype),
        regions=device_array(regions),
        non_adjacent=non_adjacent,
        outside_at_rest=device_array(1.0 - np.asarray(within)),
        area=device_array(area, dtype),
        size=device_array(size, dtype),
        names=names,
        joints=tuple(body.skeleton.names[joint] for joint in moving),
        region_parts=tuple(moving.index(joint) for joint in movers),
        part_parents=tuple(_nearest_ancestor(body.skeleton.parents, joint, moving) for joint in moving),
    )


def _nearest_ancestor(parents: Sequence[int], joint: int, among: Sequence[int]) -> int:
    """Find the index in `among` of the nearest ancestor that it contains, minus one where there is none."""
    joint = parents[joint]
    while joint >= 0 and joint not in among:
        joint = parents[joint]
    return among.index(joint) if joint >= 0 else -1


def region_name(joint: str) -> str:
    """Name the limb of a joint in words, such as "left leg"; the joint's own name where it is not a human's."""
    sided = [(words, joint.removeprefix(side)) for side, words in _SIDES.items() if joint.startswith(side)]
    for side, plain in (*sided, ("", joint)):
        for limb, names in BODY_REGIONS.items():
            if plain in names:
                return f"{side} {limb}".strip()
    return joint


def _even_samples(
    vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> tuple[Int[np.ndarray, "S 3"], Float[np.ndarray, "S 3"]]:
    """Sample triangle corners and barycentric shares at equal steps of area along Morton's curve."""
    triangles = vertices[faces]
    order = np.asarray(spatial_order(triangles.mean(1)))
    passed = np.cumsum(np.linalg.norm(area_normals(triangles), axis=1)[order])
    steps = np.searchsorted(passed, (np.arange(NUM_SAMPLES) + 0.5) / NUM_SAMPLES * passed[-1])
    # positions within the triangles by Roberts's sequence, which leaves no gaps
    first, second = ((np.arange(NUM_SAMPLES) * np.array([[0.7548776662], [0.5698402910]])) + 0.5) % 1.0
    outside = first + second > 1
    first, second = np.where(outside, 1 - first, first), np.where(outside, 1 - second, second)
    return faces[order[steps]], np.stack([1 - first - second, first, second], 1)


def _adjacent_regions(
    parents: Sequence[int], joints: Sequence[int], names: Sequence[str]
) -> Bool[np.ndarray, "R R"]:
    """Find the pairs of adjacent regions, named by `joints`: each with itself and with its parent limb.

    Skin folds between adjacent regions may intersect.
    """
    together = np.eye(len(joints), dtype=bool)
    for region, joint in enumerate(joints):
        above = _nearest_ancestor(parents, joint, joints)
        if above >= 0:
            limb = np.array([name == names[above] for name in names])
            together[region] |= limb
            together[:, region] |= limb
    return together


def region_joints(body: Body) -> tuple[int, ...]:
    """Find the joint of each region of a body, in increasing order."""
    corners, shares = _even_samples(np.asarray(body.vertices, float), np.asarray(body.faces))
    return _large_parts(body.skeleton, _sampled_bones(body, corners, shares))


def _sampled_bones(
    body: Body, corners: Int[np.ndarray, "S 3"], shares: Float[np.ndarray, "S 3"]
) -> Int[np.ndarray, "S"]:
    """Find the bone with the largest weight at the nearest corner of each sample."""
    nearest = np.take_along_axis(corners, shares.argmax(1)[:, None], 1)[:, 0]
    return np.asarray(body.skin.dominant_bones())[nearest]


def _large_parts(skeleton: Skeleton, bones: Int[np.ndarray, "S"]) -> tuple[int, ...]:
    """Find the joints of the parts that remain after the smallest are joined to their parents."""
    share = np.bincount(bones, minlength=skeleton.num_joints) / len(bones)
    plain = [without_side(name) for name in skeleton.names]
    if set(plain) >= PERSON_PARTS:
        share = np.isin(plain, list(PERSON_PARTS)).astype(float)
    into = np.arange(skeleton.num_joints)
    for joint in np.argsort(-skeleton.depths, kind="stable"):
        parent = skeleton.parents[joint]
        if share[joint] < MIN_AREA and parent >= 0:
            into[into == joint] = parent
            share[parent] += share[joint]
    return tuple(np.unique(into[bones]).tolist())


def _regions(skeleton: Skeleton, joints: Sequence[int]) -> Int[np.ndarray, "J"]:
    """Find the region of each joint: its own, or that of its nearest ancestor with one; the first without any."""
    parents = skeleton.parents
    return np.array(
        [
            joints.index(joint) if joint in joints else max(_nearest_ancestor(parents, joint, joints), 0)
            for joint in range(skeleton.num_joints)
        ]
    )
