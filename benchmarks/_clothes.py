"""Clothes made on a posed body: a skirt that hangs over both legs, a loose jacket that follows late, and hair.

They are no shells of the skin. A skirt spans the gap between the legs, keeps folds, and swings back later than the
legs; the skin under it has no points.
"""

from collections.abc import Iterator
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

import jaxcap as jc
from benchmarks._scenes import Noise, ScannedFrame, add_noise, smooth_over_surface, vertices_of_joints
from jaxcap.geometry.mesh import area_normals, sample_surface

OUTFITS = ("bare", "skirt", "jacket")
#: levels of a skirt and directions about its axis
NUM_LEVELS, NUM_DIRECTIONS = 28, 72
ANGLES = 2 * np.pi * np.arange(NUM_DIRECTIONS) / NUM_DIRECTIONS
#: joints whose skin a skirt hangs over, and its length in metres
SKIRT = ("Hips", "LHipJoint", "RHipJoint", "LowerBack", "LeftUpLeg", "RightUpLeg", "LeftLeg", "RightLeg")
LENGTH = 0.5
#: radius that the hem adds, depth of its folds and the gap to the skin, metres; share of the last shape that stays
FLARE, FOLD, GAP, INERTIA = 0.10, 0.012, 0.008, 0.6
#: joints whose skin a jacket covers, its thickness in metres, and the share of the last frame in its place
JACKET = (
    "LowerBack",
    "Spine",
    "Spine1",
    "LeftShoulder",
    "RightShoulder",
    "LeftArm",
    "RightArm",
    "LeftForeArm",
    "RightForeArm",
)
JACKET_THICKNESS, JACKET_LAG = 0.035, 0.3
#: thickness of hair, metres
HAIR_THICKNESS = 0.04

_posed = eqx.filter_jit(jc.pose_body)


class Skirt(NamedTuple):
    """A skirt: the distance of each level from a vertical axis in each direction."""

    axis: Float[np.ndarray, "2"]
    heights: Float[np.ndarray, "L"]
    radii: Float[np.ndarray, "L A"]


def jacket_offsets(body: jc.Body) -> Float[np.ndarray, "V"]:
    """Compute the offsets of a jacket along the normals, metres."""
    return JACKET_THICKNESS * smooth_over_surface(body, vertices_of_joints(body, JACKET).astype(float), 20)


def hair_offsets(body: jc.Body) -> Float[np.ndarray, "V"]:
    """Compute the offsets of hair along the normals, metres: the back and the top of the head."""
    head = body.skeleton.index("Head")
    rest, centre = np.asarray(body.vertices, float), np.asarray(body.skeleton.centres, float)[head]
    away = rest - centre
    members = vertices_of_joints(body, ("Head",))
    middle = rest[members].mean(0)
    covered = members & ((rest[:, 2] < middle[2]) | (rest[:, 1] > middle[1] + 0.06)) & (away[:, 1] > 0.0)
    return HAIR_THICKNESS * smooth_over_surface(body, covered.astype(float), 10)


def hang_skirt(
    body: jc.Body,
    vertices: Float[np.ndarray, "V 3"],
    joints: Float[np.ndarray, "J 3"],
    before: Skirt | None,
    turn: float,
) -> Skirt:
    """Hang a skirt from the waist around both legs; `before` is that of the last frame, `turn` the phase of its folds."""
    hips = joints[body.skeleton.index("Hips")]
    top = hips[1] + 0.05
    heights = top - np.linspace(0.0, LENGTH, NUM_LEVELS)
    points = vertices[vertices_of_joints(body, SKIRT)]
    axis = hips[[0, 2]]
    directions = np.stack([np.cos(ANGLES), np.sin(ANGLES)], 1)
    reach = (points[:, [0, 2]] - axis) @ directions.T
    radii = np.zeros((NUM_LEVELS, NUM_DIRECTIONS))
    for level, height in enumerate(heights):
        near = np.abs(points[:, 1] - height) < 0.02
        inside = reach[near].max(0) if near.any() else radii[level - 1]
        radii[level] = np.maximum(inside, 0.05) + GAP
    down = np.linspace(0.0, 1.0, NUM_LEVELS)[:, None]
    hanging = radii[0] + FLARE * down
    shape = np.maximum(radii, hanging)
    if before is not None:
        shape = np.maximum(radii, INERTIA * before.radii + (1 - INERTIA) * shape)
    # cloth that a knee lifts hangs down from it
    shape = np.maximum.accumulate(shape + 0.15 * down, axis=0) - 0.15 * down
    folds = FOLD * down * np.sin(9 * ANGLES + turn)
    return Skirt(axis, heights, np.maximum(radii, shape + folds))


def skirt_mesh(skirt: Skirt) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """Make the triangles of a skirt, its normals outwards."""
    x = skirt.axis[0] + skirt.radii * np.cos(ANGLES)
    z = skirt.axis[1] + skirt.radii * np.sin(ANGLES)
    y = np.broadcast_to(skirt.heights[:, None], x.shape)
    level, around = np.meshgrid(np.arange(NUM_LEVELS - 1), np.arange(NUM_DIRECTIONS), indexing="ij")
    following = (around + 1) % NUM_DIRECTIONS
    a, b = level * NUM_DIRECTIONS + around, level * NUM_DIRECTIONS + following
    c, d = a + NUM_DIRECTIONS, b + NUM_DIRECTIONS
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    return np.stack([x, y, z], -1).reshape(-1, 3), faces


def under_skirt(skirt: Skirt, points: Float[np.ndarray, "N 3"]) -> Bool[np.ndarray, "N"]:
    """Find the points that a skirt hides."""
    away = points[:, [0, 2]] - skirt.axis
    column = (
        np.round(np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) * NUM_DIRECTIONS).astype(int)
        % NUM_DIRECTIONS
    )
    step = (skirt.heights[0] - skirt.heights[-1]) / (NUM_LEVELS - 1)
    level = np.round((skirt.heights[0] - points[:, 1]) / step).astype(int)
    within = (level >= 0) & (level < NUM_LEVELS)
    radii = skirt.radii[np.clip(level, 0, NUM_LEVELS - 1), column]
    return within & (np.linalg.norm(away, axis=1) < radii - 0.002)


class Dressed(NamedTuple):
    """The surfaces of a dressed person in one frame, metres."""

    joints: Float[np.ndarray, "J 3"]
    #: the body with what follows its skin: hair or a jacket
    vertices: Float[np.ndarray, "V 3"]
    skirt: Skirt | None


def dress(body: jc.Body, motion: jc.Motion, outfit: str) -> Iterator[Dressed]:
    """Dress a person in an outfit in each frame: "bare", "skirt" with hair, or "jacket" with hair."""
    jacket, hair = jacket_offsets(body), hair_offsets(body)
    skirt, before = None, None
    for number in range(motion.num_frames):
        posed = _posed(body, motion[number])
        vertices, normals = np.asarray(posed.vertices, float), np.asarray(posed.normals, float)
        joints = np.asarray(posed.joints, float)
        worn = vertices
        if outfit != "bare":
            worn = worn + hair[:, None] * normals
        if outfit == "jacket":
            lag = JACKET_LAG * (jacket / JACKET_THICKNESS)[:, None]
            late = np.clip((vertices if before is None else before) - vertices, -0.03, 0.03)
            swing = 1.0 + 0.3 * np.sin(40.0 * np.asarray(body.vertices, float)[:, 1] + 0.2 * number)
            worn = worn + lag * late + (jacket * swing)[:, None] * normals
        if outfit == "skirt":
            skirt = hang_skirt(body, vertices, joints, skirt, 0.15 * number)
        yield Dressed(joints, worn, skirt)
        before = vertices


def dressed_mesh(body: jc.Body, dressed: Dressed) -> tuple[Float[np.ndarray, "W 3"], Int[np.ndarray, "G 3"]]:
    """Join the surfaces of a dressed person; a skirt has an inner side too."""
    faces = np.asarray(body.faces)
    if dressed.skirt is None:
        return dressed.vertices, faces
    cloth, theirs = skirt_mesh(dressed.skirt)
    theirs = theirs + len(dressed.vertices)
    return np.concatenate([dressed.vertices, cloth]), np.concatenate([faces, theirs, theirs[:, ::-1]])


def scan_clothed(
    body: jc.Body, motion: jc.Motion, outfit: str, noise: Noise, seed: int = 0
) -> list[ScannedFrame]:
    """Simulate the clouds of a person in an outfit. There are no outliers. The joints are those of the person."""
    frames, faces = [], np.asarray(body.faces)
    for number, dressed in enumerate(dress(body, motion, outfit)):
        rng = np.random.default_rng([seed, number])
        points, directions = sample_surface(dressed.vertices, faces, 2 * noise.points, rng)
        if dressed.skirt is not None:
            cloth, cloth_faces = skirt_mesh(dressed.skirt)
            density = len(points) / _area(dressed.vertices, faces)
            more, theirs = sample_surface(cloth, cloth_faces, round(density * _area(cloth, cloth_faces)), rng)
            seen = ~under_skirt(dressed.skirt, points)
            points, directions = (
                np.concatenate([points[seen], more]),
                np.concatenate([directions[seen], theirs]),
            )
        kept = rng.choice(len(points), noise.points, replace=False)
        cloud = jc.make_cloud(*add_noise(points[kept], directions[kept], noise, rng))
        frames.append(ScannedFrame(cloud, dressed.joints))
    return frames


def _area(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> float:
    return 0.5 * float(np.linalg.norm(area_normals(vertices[faces]), axis=1).sum())
