"""Hands that lie the wrong way up are turned, and others are not."""

import jax.numpy as jnp
import numpy as np
from helpers import chain_body

import jaxcap as jc
from jaxcap.body.kinematics import joint_paths
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.geometry import rotation
from jaxcap.geometry.camera import ring_of_cameras
from jaxcap.scanner.scan import scan_frame
from jaxcap.scanner.settings import Scanner
from jaxcap.tracking.limb_flips import flip_limb_ends, limb_ends
from jaxcap.tracking.track_frame import make_tracker


def test_ends_are_hands_feet_and_the_head():
    body = jc.human(joints="tracking", resolution="low")
    names = {body.skeleton.names[joint] for joint in limb_ends(body)}
    assert names == {"Head", "LeftHand", "RightHand", "LeftToeBase", "RightToeBase"}
    assert all(chain_body().skeleton.kinds[joint] == "ball" for joint in limb_ends(chain_body()))


def test_a_hand_is_turned_back():
    body = jc.human(joints="tracking", resolution="medium")
    skeleton = body.skeleton
    motion = walk_and_wave(skeleton, 1.0).slice(slice(20, 22))
    clouds, wrong = [], []
    hand = skeleton.index("LeftHand")
    tip = skeleton.centres[skeleton.index("LeftHandFinger1")] - skeleton.centres[hand]
    over = rotation.exp(jnp.pi * tip / jnp.linalg.norm(tip))
    for frame in range(2):
        vertices = np.asarray(jc.pose_body(body, motion[frame]).vertices, float)
        cameras = ring_of_cameras(6, 360.0, 2.5, 0.3, tuple(vertices.mean(0).tolist()), (240, 320))
        seen = scan_frame(
            Scanner(noise=0.003), cameras, vertices, np.asarray(body.faces), seed=1, frame=frame
        )
        clouds.append(jc.make_cloud(seen.points, seen.normals))
        pose = motion[frame]
        turned = pose.rotations.at[hand].set(rotation.multiply(pose.rotations[hand], over))
        wrong.append(jc.Pose(pose.translations, turned, pose.scale))
    tracker = make_tracker(body)
    truth = np.asarray(joint_paths(skeleton, motion.poses))

    def off(poses):
        found = np.asarray(joint_paths(skeleton, jc.stack_poses(poses).poses))
        return np.linalg.norm(found - truth, axis=-1)[:, skeleton.index("LThumb")].max()

    assert off(wrong) > 0.03
    assert off(flip_limb_ends(tracker, clouds, wrong)) < 0.01
    right = [motion[frame] for frame in range(2)]
    assert off(flip_limb_ends(tracker, clouds, right)) == 0
