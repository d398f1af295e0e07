"""Several people in one scene: walks past each other, and a handshake."""

from pathlib import Path
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

import jaxcap as jc
from benchmarks._scenes import RATE, human_motion
from benchmarks.depth.depth_rooms import visible_joints
from jaxcap.body.people.anatomy import rest_deviations
from jaxcap.depth import cloud_of_depths, find_people
from jaxcap.depth.fuse import fuse_cloud
from jaxcap.energy.data.landmarks import JointLandmarks
from jaxcap.energy.energy import Sum
from jaxcap.energy.priors.reference_pose import ReferencePrior
from jaxcap.geometry import rotation
from jaxcap.geometry.camera import Camera
from jaxcap.scanner.scan import scan_scene
from jaxcap.scanner.sensors import Sensor

Scenario = Literal["two_walk", "three_walk", "handshake", "two_walk_camera"]
BUILDS: tuple[dict[str, Any], ...] = (
    dict(sex="female", age=22, weight=0.25, muscle=0.45, height=1.58),
    dict(sex="male", age=28, weight=0.4, muscle=0.8, height=1.88),
    dict(sex="male", age=55, weight=0.9, muscle=0.4, height=1.75),
)
#: take of each person, its direction about the vertical in degrees, and where the middle of the path is, metres
WALKS = (("02_01", 0.0, (-0.3, 0.0)), ("02_02", 180.0, (0.3, 0.0)), ("02_01", 90.0, (0.0, 0.75)))
#: take whose first frame is the stance of a handshake, distance of the people, height of the hands above the floor, and half
#: the distance of the wrists, metres
STANCE, HANDS_HEIGHT, HALF_WRISTS = "02_05", 1.0, 0.075
HANDSHAKE_DISTANCE = 1.05
#: amplitude of the shaking hands, metres, and its frequency, per second
SHAKE, SHAKE_RATE = 0.04, 2.0

_pose_body = eqx.filter_jit(jc.pose_body)


class People(NamedTuple):
    """People who move in one scene."""

    bodies: list[jc.Body]
    #: of each person, in the same frames
    motions: list[jc.Motion]
    #: (K, F, J, 3) metres
    joints: np.ndarray


def make_people(shared: Path, scenario: Scenario, frames: int | None = None) -> People:
    """Make the people of a scenario and their motions, at 30 frames per second."""
    count = 3 if scenario == "three_walk" else 2
    bodies = [jc.human(joints="tracking", resolution="medium", **build) for build in BUILDS[:count]]
    motions = shake_hands(shared, bodies) if scenario == "handshake" else walk(shared, bodies)
    length = min(len(motion) for motion in motions)
    first = 0 if frames is None else max((length - frames) // 2, 0)
    last = length if frames is None else first + frames
    motions = [motion.slice(slice(first, last)) for motion in motions]
    joints = np.array(
        [
            [np.asarray(_pose_body(body, motion[f]).joints, float) for f in range(len(motion))]
            for body, motion in zip(bodies, motions, strict=True)
        ]
    )
    return People(bodies, motions, joints)


def walk(shared: Path, bodies: list[jc.Body]) -> list[jc.Motion]:
    """Make walks of all people, whose paths have their middles as in `WALKS`."""
    motions = []
    for body, (take, degrees, middle) in zip(bodies, WALKS, strict=False):
        motion = human_motion(shared, take, body)
        turned = [place(body, motion[f], degrees) for f in range(len(motion))]
        ends = np.array([np.asarray(_pose_body(body, turned[f]).joints[0]) for f in (0, -1)])
        shift = np.array([middle[0], 0.0, middle[1]]) - ends.mean(0) * [1.0, 0.0, 1.0]
        motions.append(jc.stack_poses([moved(pose, shift) for pose in turned], RATE))
    return motions


def shake_hands(shared: Path, bodies: list[jc.Body], seconds: float = 2.5) -> list[jc.Motion]:
    """Make two people who face each other, reach out, shake their right hands, and lower them."""
    count = round(seconds * RATE)
    stances, skeleton = [], bodies[0].skeleton
    for body, (degrees, side) in zip(bodies, ((90.0, -0.5), (-90.0, 0.5)), strict=True):
        pose = place(body, human_motion(shared, STANCE, body, 1)[0], degrees)
        posed = _pose_body(body, pose)
        floor = float(posed.vertices[:, 1].min())
        root = np.asarray(posed.joints[0], float)
        shift = np.array([side * HANDSHAKE_DISTANCE - root[0], -floor, -root[2]])
        stances.append(moved(pose, shift))
    hand = skeleton.index("RightHand")
    motions = []
    for body, stance, side in zip(bodies, stances, (-1.0, 1.0), strict=True):
        before = np.asarray(_pose_body(body, stance).joints[hand], float)
        poses, pose = [], stance
        for frame in range(count):
            share = frame / (count - 1)
            # out in the first third, back in the last one
            out = np.clip(3 * min(share, 1 - share), 0.0, 1.0)
            reach = out**2 * (3 - 2 * out)
            meet = np.array([side * HALF_WRISTS, HANDS_HEIGHT, 0.0])
            meet[1] += SHAKE * np.sin(2 * np.pi * SHAKE_RATE * frame / RATE) * reach
            pose = reach_with(body, stance, pose, hand, (1 - reach) * before + reach * meet)
            poses.append(pose)
        motions.append(jc.stack_poses(poses, RATE))
    return motions


def reach_with(body: jc.Body, stance: jc.Pose, start: jc.Pose, joint: int, target: np.ndarray) -> jc.Pose:
    """Move a joint to a target, with the other joints near a stance."""
    count = body.skeleton.num_joints
    targets = jnp.zeros((count, 3)).at[joint].set(jnp.asarray(target))
    weights = jnp.zeros(count).at[joint].set(1e6)
    return _reach_with(body, stance, start, targets, weights)


@eqx.filter_jit
def _reach_with(body, stance, start, targets, weights) -> jc.Pose:
    radians = jnp.asarray(rest_deviations(body.skeleton, 0.3), targets.dtype)
    near = ReferencePrior(stance, jnp.full(len(weights), 1e-3), radians.at[0].set(1e-2))
    return jc.solve(Sum((JointLandmarks(targets, weights), near)), body, start).pose


def place(body: jc.Body, pose: jc.Pose, degrees: float) -> jc.Pose:
    """Rotate a pose about the vertical through the origin."""
    q = rotation.about_axis(jnp.array([0.0, 1.0, 0.0]), jnp.asarray(np.radians(degrees)))
    centre = body.skeleton.centres[0]
    position = rotation.rotate(q, pose.translations[0] + centre) - centre
    return jc.Pose(
        pose.translations.at[0].set(position),
        pose.rotations.at[0].set(rotation.multiply(q, pose.rotations[0])),
        pose.scale,
    )


def moved(pose: jc.Pose, shift: np.ndarray) -> jc.Pose:
    """Shift the root of a pose, metres."""
    return eqx.tree_at(lambda p: p.translations, pose, pose.translations.at[0].add(jnp.asarray(shift)))


def surfaces(people: People, frame: int, who: list[int]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Pose some people in a frame: vertices and triangles of each."""
    return [
        (
            np.asarray(_pose_body(people.bodies[k], people.motions[k][frame]).vertices, float),
            np.asarray(people.bodies[k].faces),
        )
        for k in who
    ]


def scan_people(
    people: People, who: list[int], cameras, scanner, points: int, seed: int = 0
) -> list[jc.Cloud]:
    """Scan some of the people in every frame; `points` of each are kept on average."""
    clouds = []
    for frame in range(len(people.motions[0])):
        images = scan_scene(scanner, cameras, surfaces(people, frame, who), seed, frame)
        scan = fuse_cloud(cameras, [image.depth for image in images], scanner.gap, scanner.normal_window)
        rng = np.random.default_rng([seed, frame])
        kept = rng.choice(len(scan.points), min(points * len(who), len(scan.points)), replace=False)
        clouds.append(jc.make_cloud(scan.points[kept], scan.normals[kept], name=f"frame {frame}"))
    return clouds


def film_people(
    people: People, who: list[int], camera: Camera, sensor: Sensor, seed: int = 0
) -> tuple[list[jc.Cloud], np.ndarray]:
    """Make the cloud of the people that are found in each depth image of one camera, and find the visible joints.

    They are (K, F, J), of the people in `who`.
    """
    clouds, visible = [], []
    for frame in range(len(people.motions[0])):
        (image,) = scan_scene(sensor.errors, [camera], surfaces(people, frame, who), seed, frame)
        masks = find_people(camera, image.depth, len(who), f"frame {frame}")
        mask = np.any(masks, axis=0)
        clouds.append(cloud_of_depths([camera], [image.depth], [mask], name=f"frame {frame}"))
        visible.append(
            [
                visible_joints(
                    camera, people.joints[k, frame], np.where(image.labels == label, image.depth, 0.0)
                )
                for label, k in enumerate(who)
            ]
        )
    return clouds, np.swapaxes(np.array(visible), 0, 1)
