"""Differences between rest poses on both sides of a joint, and the refusals that they cause."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.pose import Motion
from jaxcap.body.skeleton import make_skeleton
from jaxcap.limits.rest_poses.rest_difference import rest_difference


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
        joint: jc.limits.gather_samples([(skeleton, motion)], joint) for joint in ("shoulder", "elbow")
    }
    return motion, jc.limits.learn_limits(samples, voxel=np.radians(20))


@pytest.mark.parametrize("angle", [0.0, 12.0, 45.0, 170.0])
def test_angles_of_bones_are_those_by_which_they_were_rotated(angle):
    found = {joint: rest_difference(arm(0.0), arm(angle), joint) for joint in ("shoulder", "elbow", "wrist")}
    # the upper arm is the distal segment of the shoulder and the proximal one of the elbow
    for joint in ("shoulder", "elbow"):
        assert np.degrees(found[joint].angle) == pytest.approx(angle, abs=1e-6)
    # the forearm has its direction
    assert found["wrist"].angle < 1e-7
    if angle:
        assert found["elbow"].direction == "the bone from 'shoulder' to 'elbow'"


def test_rotations_about_a_bone_are_shown_by_hinges_and_by_several_joints():
    centres = np.array([[0, 0, 0], [0.3, 0, 0], [0.55, 0.05, 0], [0.55, -0.05, 0]])

    def hand(twist: float, elbow: str):
        """An elbow and a hand with two fingers, rotated about x below the shoulder."""
        turned = Rotation.from_euler("x", twist, degrees=True)
        axes = [turned.apply([[0, 0, 1], [0, 1, 0]])] * 4
        kinds = ["ball", elbow, "ball", "ball"]
        return make_skeleton(
            ["shoulder", "elbow", "index", "little"], [-1, 0, 1, 1], kinds, turned.apply(centres), axes=axes
        )

    shown = rest_difference(hand(0.0, "revolute"), hand(30.0, "revolute"), "shoulder")
    assert np.degrees(shown.angle) == pytest.approx(30.0) and shown.direction == "the axis of 'elbow'"
    assert rest_difference(hand(0.0, "revolute"), hand(180.0, "revolute"), "shoulder").angle < 1e-6
    assert rest_difference(hand(0.0, "ball"), hand(30.0, "ball"), "shoulder").angle < 1e-6
    # fingers move on a circle of 5 cm at 25 cm
    chord = (
        2
        * np.hypot(0.25, 0.05)
        * np.sin(rest_difference(hand(0, "ball"), hand(180, "ball"), "elbow").angle / 2)
    )
    assert chord == pytest.approx(0.1, abs=1e-6)


def test_files_of_limits_are_refused_for_another_rest_pose(limits, tmp_path):
    jc.io.save_limits(tmp_path / "limits.npz", limits[1])
    assert jc.io.read_limits(tmp_path / "limits.npz", arm(10.0)).surfaces
    with pytest.raises(
        jc.InputError,
        match=r"limits.npz: .*another rest pose: the bone from 'shoulder' to 'elbow' differs by 45 .* 'shoulder' is no rec",
    ):
        jc.io.read_limits(tmp_path / "limits.npz", arm(45.0))
    # limits of the elbow alone, whose proximal bone differs
    jc.io.save_limits(tmp_path / "elbow.npz", jc.limits.SurfaceLimits(limits[1].surfaces[1:]))
    with pytest.raises(
        jc.InputError, match=r"from 'shoulder' to 'elbow' differs by 45 .* 'elbow' is no recognised"
    ):
        jc.io.read_limits(tmp_path / "elbow.npz", arm(45.0))
    other = make_skeleton(["arm", "elbow", "wrist"], [-1, 0, 1], ["ball"] * 3, np.asarray(arm(0.0).centres))
    with pytest.raises(jc.InputError, match=r"joints above and below 'elbow' are not among the joints arm"):
        jc.io.read_limits(tmp_path / "elbow.npz", other)


@pytest.mark.parametrize("angle", [0.0, 45.0])
def test_files_of_an_earlier_version_are_refused_where_nothing_shows_their_rest_pose(limits, tmp_path, angle):
    """It wrote the direction of the bone below each joint, and neither a skeleton nor the growth of the margin."""
    jc.io.save_limits(tmp_path / "limits.npz", limits[1])
    with np.load(tmp_path / "limits.npz") as file:
        arrays = {
            name: values
            for name, values in file.items()
            if ".rest." not in name and not name.endswith(("growth", "key_radius"))
        }
    arrays |= {"0.bone": np.array([1.0, 0, 0]), "1.bone": np.array([1.0, 0, 0])}
    np.savez(tmp_path / "earlier.npz", **arrays)
    with pytest.raises(
        jc.InputError,
        match=r"earlier.npz: the limits of 'shoulder' are without the rest pose .*; learn the limits again",
    ):
        jc.io.read_limits(tmp_path / "earlier.npz", arm(angle))


def test_files_with_left_handed_axes_or_another_skeleton_are_refused(limits, tmp_path):
    surface = limits[1].surfaces[0]
    known = jc.limits.AnatomicalJoint(
        "shoulder_l", "shoulder", jnp.eye(3), jnp.diag(jnp.asarray([1.0, 1.0, -1.0]))
    )
    mirrored = eqx.tree_at(lambda s: s.anatomy, surface, known, is_leaf=lambda leaf: leaf is None)
    jc.io.save_limits(tmp_path / "mirrored.npz", jc.limits.SurfaceLimits((mirrored,)))
    with pytest.raises(jc.InputError, match="axes of 'shoulder' are not orthonormal and right-handed"):
        jc.io.load_limits(tmp_path / "mirrored.npz")
    jc.io.save_limits(tmp_path / "whole.npz", limits[1])
    again = jc.io.load_limits(tmp_path / "whole.npz").surfaces[0].rest
    assert again is not None and eqx.tree_equal(again, surface.rest)
    arrays = dict(np.load(tmp_path / "whole.npz"))
    arrays["0.rest.names"] = np.array(["a", "b", "c"])
    np.savez(tmp_path / "damaged.npz", **arrays)
    with pytest.raises(jc.InputError, match="skeleton of the limits of 'shoulder' has no such joint"):
        jc.io.load_limits(tmp_path / "damaged.npz")


def test_motions_of_two_rest_poses_are_not_mixed(limits):
    motion, _ = limits
    mixed = [(arm(0.0), motion), (arm(5.0), motion), (arm(60.0), motion)]
    assert len(jc.limits.gather_samples(mixed[:2], "shoulder").rotations) == 600
    with pytest.raises(
        ValueError,
        match="third: its rest pose is not that of the motions before, so rotations of 'shoulder'.* 60",
    ):
        jc.limits.gather_samples(mixed, "shoulder", names=["first", "second", "third"])
