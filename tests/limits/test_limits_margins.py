"""Margins of limits for other takes and people, and joints that turn fully."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from limits_legs import HUMAN, leg_motion, quaternions
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.limits.learning.held_out import make_folds, mean_quantile, widest_held_out
from jaxcap.limits.learning.samples import JointSamples


def spin(joint: str, frames: int = 400) -> JointSamples:
    turns = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, frames)[:, None] * [0.0, 0, 1])
    return JointSamples(joint, "ball", np.eye(3)[:2], quaternions(turns), np.arange(frames) // 40)


def test_full_turns_are_left_out_and_named():
    child = JointSamples(
        "child",
        "ball",
        np.eye(3)[:2],
        quaternions(Rotation.from_rotvec(np.random.default_rng(1).uniform(-0.5, 0.5, (400, 3)))),
        np.arange(400) // 40,
        spin("wheel"),
    )
    found = jc.limits.find_full_turns({"wheel": spin("wheel"), "child": child})
    assert list(found) == ["wheel"] and np.degrees(found["wheel"]) > 340
    limits = jc.limits.learn_limits({"wheel": spin("wheel"), "child": child})
    assert [(each.joint, each.parent) for each in limits.surfaces] == [("child", None)]
    with pytest.raises(jc.InputError, match="wheel rotate through a full turn"):
        jc.limits.learn_limits({"wheel": spin("wheel")})


def test_margins_are_the_distances_between_takes():
    """Two takes of a hinge: from 0 to 40 degrees, and from 20 to 60: 20 degrees of each are not in the other."""
    angles = np.concatenate([np.linspace(0, 40, 2000), np.linspace(20, 60, 2000)])
    turned = quaternions(Rotation.from_euler("z", angles[:, None], degrees=True))
    takes = np.repeat([0, 1], 2000)
    samples = JointSamples(
        "hinge",
        "revolute",
        np.eye(3)[[2, 0]],
        turned,
        np.zeros(4000, int),
        takes=takes,
        people=np.zeros(4000, int),
    )
    assert widest_held_out(samples) == "takes"
    train, test = make_folds(samples, "takes")[0]
    assert set(takes[train]) == {1} and set(takes[test]) == {0}
    whole, most = (
        float(np.degrees(2 * jc.limits.learn_limits({"h": samples}, coverage=share).surfaces[0].margin))
        for share in (1.0, 0.75)
    )
    # without the width of a voxel, two degrees
    assert whole == pytest.approx(20.0, abs=2.0)
    assert most == pytest.approx(10.0, abs=2.0)
    one = samples._replace(takes=None)
    assert widest_held_out(one) == "blocks"
    assert float(jc.limits.learn_limits({"h": one}).surfaces[0].margin) == 0.0


def test_margins_are_measured_from_voxels_with_enough_samples():
    """The first take covers 0 to 40 degrees densely and has one frame at 59; the second one covers 0 to 60 degrees."""
    angles = np.concatenate([np.linspace(0, 40, 2000), [59.0], np.linspace(0, 60, 3000)])
    samples = JointSamples(
        "hinge",
        "revolute",
        np.eye(3)[[2, 0]],
        quaternions(Rotation.from_euler("z", angles[:, None], degrees=True)),
        np.zeros(len(angles), int),
        takes=np.repeat([0, 1], [2001, 3000]),
    )

    def margin(least: int) -> float:
        found = jc.limits.learn_limits({"h": samples}, coverage=1.0, min_samples=least).surfaces[0]
        return float(np.degrees(2 * found.margin))

    # half of the way from 40 to 59, and the whole way to 60, less the width of a voxel
    assert margin(1) == pytest.approx(9.0, abs=1.5)
    assert margin(5) == pytest.approx(19.0, abs=1.5)
    with pytest.raises(jc.InputError, match="No voxel has 500 samples when a part of the motion is left out"):
        margin(500)


def test_margins_grow_where_the_parent_was_not_seen():
    """The parent of the second take goes on to 60 degrees, and the child bends by two degrees more for each of them."""
    rng = np.random.default_rng(0)
    above = np.concatenate([rng.uniform(0, 30, 4000), rng.uniform(0, 60, 4000)])
    most = 20 + 2 * np.maximum(above - 30, 0) * (np.arange(8000) >= 4000)
    skeleton = jc.make_skeleton(
        ("a", "b"), (-1, 0), ("revolute",) * 2, [[0.0, 0, 0], [1, 0, 0]], axes=[np.eye(3)[[2, 0]]] * 2
    )

    def turns(angles) -> np.ndarray:
        return quaternions(Rotation.from_euler("z", np.asarray(angles, float)[:, None], degrees=True))

    parent, child = (
        JointSamples(
            name,
            "revolute",
            np.eye(3)[[2, 0]],
            turns(angles),
            np.zeros(8000, int),
            takes=np.repeat([0, 1], 4000),
        )
        for name, angles in (("a", above), ("b", rng.uniform(0, most)))
    )
    surface = jc.limits.learn_limits({"b": child._replace(parent=parent)}, coverage=0.999).surfaces[0]
    # the second take goes 60 degrees beyond the first one, all of it where the parent was not seen
    assert np.degrees(2 * float(surface.margin)) < 15
    asked = [(10, 18), (10, 60), (59, 70), (80, 100), (80, 175)]
    rotations = np.stack([turns(column) for column in zip(*asked, strict=True)], 1)
    motion = jc.Motion(jc.Pose(jnp.zeros((5, 2, 3)), jnp.asarray(rotations), jnp.ones(5)), 30.0)
    limits = jc.limits.SurfaceLimits((surface,))
    assert np.asarray(jc.limits.allowed_frames(limits, skeleton, motion))[:, 1].tolist() == [
        True,
        False,
        True,
        True,
        False,
    ]
    # the growth is no part of what was seen
    distances = np.degrees(np.asarray(jc.limits.sample_distance_frames(limits, skeleton, motion)))[:, 0]
    np.testing.assert_allclose(distances[[0, 2, 3]], [0, 0, 20], atol=5.0)


def test_a_given_margin_grows_alike_with_given_and_with_chosen_keyframes():
    takes = [(HUMAN, leg_motion(seed)) for seed in range(2)]
    knee = jc.biomechanics.gather_person_samples(takes, "LeftLeg", "LeftUpLeg")
    growths = [
        [float(each.growth) for each in jc.limits.learn_limits(both, margin=np.radians(10), **more).surfaces]
        for both in [{"LeftUpLeg": knee.parent, "LeftLeg": knee}]
        for more in ({}, {"keyframe": np.radians(40)})
    ]
    # two degrees for each degree of the parent; a joint without a parent has no growth
    assert growths == [[0.0, 2.0]] * 2


def test_the_margin_between_people_is_that_of_children_too():
    takes = [(HUMAN, leg_motion(seed)) for seed in range(2)]
    knee = jc.biomechanics.gather_person_samples(takes, "LeftLeg", "LeftUpLeg")
    sizes = {"voxel": np.radians(20), "keyframe": np.radians(40), "margin": np.radians(5)}
    found = jc.limits.learn_limits(
        {"LeftUpLeg": knee.parent, "LeftLeg": knee}, person_margin=np.radians(7), **sizes
    )
    assert [float(np.degrees(2 * each.margin)) for each in found.surfaces] == pytest.approx([12.0, 12.0])


def test_the_quantile_weighs_folds_equally():
    folds = [np.arange(10.0), np.array([100.0])]
    assert mean_quantile(folds, 0.5) == 9.0
    assert mean_quantile(folds, 0.51) == 100.0


def test_the_distance_from_what_was_seen_is_an_angle():
    turns = np.random.default_rng(0).uniform(-0.3, 0.3, (4000, 3))
    samples = JointSamples(
        "s", "ball", np.eye(3)[:2], quaternions(Rotation.from_rotvec(turns)), np.arange(4000) // 400
    )
    skeleton = jc.make_skeleton(("s",), (-1,), ("ball",), [[0.0, 0, 0]])
    limits = jc.limits.learn_limits({"s": samples}, voxel=np.radians(4), margin=np.radians(15))
    angles = np.radians([0.0, 15.0, 25.0, 60.0, 120.0])
    rotations = quaternions(Rotation.from_rotvec(angles[:, None] * [1.0, 0, 0]))[:, None]
    motion = jc.Motion(jc.Pose(jnp.zeros((5, 1, 3)), jnp.asarray(rotations), jnp.ones(5)), 30.0)
    found = np.degrees(np.asarray(jc.limits.sample_distance_frames(limits, skeleton, motion)))[:, 0]
    expected = np.maximum(np.degrees(angles) - np.degrees(0.3), 0.0)
    # samples at the corner of the cube of rotation vectors, and the balls around voxels of four degrees, are nearer
    np.testing.assert_allclose(found, expected, atol=5.0)
    assert np.asarray(jc.limits.allowed_frames(limits, skeleton, motion))[:, 0].tolist() == [
        True,
        True,
        True,
        False,
        False,
    ]
    slope = jax.grad(
        lambda q: jc.limits.sample_distance(limits, skeleton, jc.Pose(jnp.zeros((1, 3)), q, jnp.ones(())))[0]
    )
    assert np.isfinite(np.asarray(slope(jnp.asarray(rotations[3])))).all()
