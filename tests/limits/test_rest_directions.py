"""Limits are valid for one rest pose: directions of bones at rest, and the refusals that compare them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.pose import Motion
from jaxcap.body.skeleton import make_skeleton
from jaxcap.limits.implicit_surface import rest_difference
from jaxcap.limits.rest_poses.rest_directions import bone_angle, bone_direction


def arm(angle: float):
    """A shoulder with an elbow and a wrist, whose upper arm is rotated by an angle about z at rest, degrees."""
    turned = Rotation.from_euler("z", angle, degrees=True)
    centres = [[0, 0, 0], turned.apply([0.3, 0, 0]), turned.apply([0.3, 0, 0]) + [0.25, 0, 0]]
    return make_skeleton(
        names=["shoulder", "elbow", "wrist"],
        parents=[-1, 0, 1],
        kinds=["ball", "ball", "ball"],
        centres=np.array(centres, float),
    )


@pytest.fixture(scope="module")
def limits():
    skeleton = arm(0.0)
    rng = np.random.default_rng(3)
    poses = jc.stack_poses([jc.rest_pose(skeleton)] * 300).poses
    turns = (
        Rotation.from_rotvec(rng.uniform(-0.4, 0.4, (900, 3))).as_quat(scalar_first=True).reshape(300, 3, 4)
    )
    motion = Motion(eqx.tree_at(lambda p: p.rotations, poses, jnp.asarray(turns)), 30.0)
    samples = {
        joint: jc.limits.gather_samples([(skeleton, motion)], joint) for joint in ("shoulder", "wrist")
    }
    return motion, jc.limits.learn_limits(samples, voxel=np.radians(20))


@pytest.mark.parametrize("angle", [0.0, 12.0, 45.0, 170.0])
def test_angles_of_bones_are_those_by_which_they_were_rotated(angle):
    found = bone_angle(bone_direction(arm(0.0), "shoulder"), bone_direction(arm(angle), "shoulder"))
    assert np.degrees(found) == pytest.approx(angle, abs=1e-6)
    # the forearm has its direction, the wrist has none, and matches everything
    assert bone_angle(bone_direction(arm(0.0), "elbow"), bone_direction(arm(angle), "elbow")) < 1e-7
    assert not bone_direction(arm(angle), "wrist").any()


def test_the_joint_that_differs_most_is_named(limits):
    joint, angle = rest_difference(limits[1], arm(-30.0))
    assert joint == "shoulder"
    assert np.degrees(angle) == pytest.approx(30.0, abs=1e-4)


def test_files_of_limits_are_refused_for_another_rest_pose(limits, tmp_path):
    jc.io.save_limits(tmp_path / "limits.npz", limits[1])
    assert jc.io.read_limits(tmp_path / "limits.npz", arm(10.0)).surfaces
    with pytest.raises(
        jc.InputError, match=r"limits.npz: .*another rest pose: the bone of 'shoulder' differs by 45"
    ):
        jc.io.read_limits(tmp_path / "limits.npz", arm(45.0))


def test_motions_of_two_rest_poses_are_not_mixed(limits):
    motion, _ = limits
    mixed = [(arm(0.0), motion), (arm(5.0), motion), (arm(60.0), motion)]
    assert len(jc.limits.gather_samples(mixed[:2], "shoulder").rotations) == 600
    with pytest.raises(
        ValueError, match="third: its rest pose is not that of the motions before: .*'shoulder'.* 55"
    ):
        jc.limits.gather_samples(mixed, "shoulder", names=["first", "second", "third"])
