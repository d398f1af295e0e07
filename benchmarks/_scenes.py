"""CMU motions on the embedded human, and simulated scans of them."""

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

import jaxcap as jc
from benchmarks.report import progress
from jaxcap.geometry.mesh import sample_surface
from jaxcap.io.skeletons.amc import read_amc
from jaxcap.io.skeletons.asf import read_asf

#: frames per second of the database, and those that are tracked
CAPTURE_RATE, RATE = 120.0, 30.0
#: metres around the box of a body in which outliers lie
OUTLIER_MARGIN = 0.1

#: the whole surface; what faces a camera far off along +z; of that, what nothing hides from it
Visible = Literal["whole", "front", "camera"]

_pose_body = eqx.filter_jit(jc.pose_body)


class Noise(NamedTuple):
    """The errors of a simulated cloud."""

    points: int = 5000
    #: standard deviation along each axis, metres
    deviation: float = 0.005
    #: root mean square of the tilt of normals, degrees
    tilt: float = 10.0
    #: share of points anywhere in the box around the body
    outliers: float = 0.1


NOISE = Noise()


class ScannedFrame(NamedTuple):
    """The cloud of one frame and its true joints."""

    cloud: jc.Cloud
    joints: Float[np.ndarray, "J 3"]


def shared_folder() -> Path:
    """Find the folder of captures: JAXCAP_SHARED, or `shared` next to the checkout. Exit with a message if there is none."""
    beside = Path(__file__).resolve().parents[2] / "shared"
    shared = Path(os.environ.get("JAXCAP_SHARED") or beside)
    if not (shared / "data" / "motion").is_dir():
        progress(f"{shared} has no folder data/motion; set JAXCAP_SHARED to the folder of captures.")
        sys.exit(2)
    return shared


def takes_of(shared: Path, subject: str) -> list[str]:
    """List the takes of one subject, such as `02_05` of `02`."""
    return sorted(path.stem for path in (shared / "data" / "motion").glob(f"{subject}_*.amc"))


def cmu_motion(shared: Path, take: str) -> tuple[jc.Motion, jc.Skeleton]:
    """Load a take as captured, with its skeleton."""
    folder = shared / "data" / "motion"
    asf = read_asf(folder / f"{take.split('_')[0]}.asf")
    return read_amc(folder / f"{take}.amc", asf, CAPTURE_RATE), asf.skeleton


def human_motion(shared: Path, take: str, body: jc.Body, frames: int | None = None) -> jc.Motion:
    """Retarget a take to a body at 30 frames per second, its first `frames` or all."""
    motion, skeleton = cmu_motion(shared, take)
    motion = motion.slice(slice(None, None, round(CAPTURE_RATE / RATE)))
    return jc.retarget(motion.slice(slice(frames)), skeleton, body.skeleton)


def scan_frame(
    body: jc.Body,
    pose: jc.Pose,
    rng: np.random.Generator,
    noise: Noise = NOISE,
    visible: Visible = "whole",
    turn: Float[np.ndarray, "3 3"] | None = None,
    clothes: Float[np.ndarray, "V"] | None = None,
) -> ScannedFrame:
    """Simulate a cloud of a posed body's surface, uniform by area.

    `turn` rotates the scene. `clothes` are offsets of each vertex along its normal, metres, reduced by up to 30 % at
    random in each frame.
    """
    posed = _pose_body(body, pose)
    vertices, joints = np.asarray(posed.vertices, float), np.asarray(posed.joints, float)
    if clothes is not None:
        across = np.asarray(body.vertices, float)[:, 0]
        swing = 1.0 - 0.3 * (0.5 + 0.5 * np.sin(30.0 * across + rng.uniform(0, 2 * np.pi)))
        vertices = vertices + (clothes * swing)[:, None] * np.asarray(posed.normals, float)
    if turn is not None:
        vertices, joints = vertices @ turn.T, joints @ turn.T
    points, normals = _surface(vertices, np.asarray(body.faces), noise.points, visible, rng)
    points, normals = add_noise(points, normals, noise, rng)
    wild = rng.choice(len(points), round(noise.outliers * len(points)), replace=False)
    box = vertices.min(0) - OUTLIER_MARGIN, vertices.max(0) + OUTLIER_MARGIN
    points[wild] = rng.uniform(*box, (len(wild), 3))
    normals[wild] = rng.normal(size=(len(wild), 3))
    return ScannedFrame(jc.make_cloud(points, normals), joints)


def clothing_offsets(body: jc.Body, thickness: float = 0.06) -> Float[np.ndarray, "V"]:
    """Compute the offsets of clothes at thighs and trunk from each vertex, metres, smoothed along the surface."""
    covered = ("Hips", "LHipJoint", "RHipJoint", "LowerBack", "Spine", "LeftUpLeg", "RightUpLeg")
    cloth = smooth_over_surface(body, vertices_of_joints(body, covered).astype(float), 60)
    return thickness * cloth / cloth.max()


def vertices_of_joints(body: jc.Body, joints: Sequence[str]) -> Bool[np.ndarray, "V"]:
    """Find the vertices that some joints, by name, move most."""
    return np.isin(np.asarray(body.skeleton.names), joints)[np.asarray(body.skin.dominant_bones())]


def smooth_over_surface(body: jc.Body, values: Float[np.ndarray, "V"], rounds: int) -> Float[np.ndarray, "V"]:
    """Average values with those of neighbouring vertices, again and again."""
    corners = np.asarray(body.faces)
    starts, ends = corners.ravel(), np.roll(corners, 1, axis=1).ravel()
    degree = np.maximum(np.bincount(starts, minlength=len(values)), 1)
    for _ in range(rounds):
        values = 0.5 * values + 0.5 * np.bincount(starts, values[ends], len(values)) / degree
    return values


def add_noise(
    points: Float[np.ndarray, "N 3"],
    normals: Float[np.ndarray, "N 3"],
    noise: Noise,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 3"]]:
    """Add the errors of points and normals, without outliers."""
    points = points + noise.deviation * rng.normal(size=points.shape)
    return points, normals + np.radians(noise.tilt) / np.sqrt(2) * rng.normal(size=normals.shape)


def scan_motion(
    body: jc.Body,
    motion: jc.Motion,
    noise: Noise = NOISE,
    visible: Visible = "whole",
    seed: int = 0,
) -> list[ScannedFrame]:
    """Simulate a cloud of every frame, each with its own seed."""
    generators = [np.random.default_rng([seed, frame]) for frame in range(motion.num_frames)]
    return [scan_frame(body, motion[k], rng, noise, visible) for k, rng in enumerate(generators)]


def rotation_about_y(angle: float) -> Float[np.ndarray, "3 3"]:
    """Make a rotation about y; `angle` in radians."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _surface(vertices, faces, count: int, visible: Visible, rng: np.random.Generator):
    """Sample `count` visible points, with the normals of their triangles."""
    if visible == "whole":
        return sample_surface(vertices, faces, count, rng)
    points, normals = sample_surface(vertices, faces, 10 * count, rng)
    kept = normals[:, 2] > 0
    if visible == "camera":
        kept &= _is_visible(points)
    chosen = rng.choice(np.flatnonzero(kept), count, replace=False)
    return points[chosen], normals[chosen]


def _is_visible(points: Float[np.ndarray, "N 3"], pixel: float = 0.01) -> Bool[np.ndarray, "N"]:
    """Test which points no point of the same pixel occludes along z by more than two pixels."""
    columns, rows = np.floor((points[:, :2] - points[:, :2].min(0)) / pixel).astype(int).T
    pixels = rows * (columns.max() + 1) + columns
    nearest = np.full(pixels.max() + 1, -np.inf)
    np.maximum.at(nearest, pixels, points[:, 2])
    return points[:, 2] > nearest[pixels] - 2 * pixel
