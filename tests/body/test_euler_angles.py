"""Joint angles against SciPy's Euler angles, and over motions."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.euler_angles import euler_angles, matrix_euler_angles
from jaxcap.geometry import rotation

ORDERS = ("xyz", "xzy", "yxz", "yzx", "zxy", "zyx")
CHAIN = jc.make_skeleton(
    ["root", "knee"], [-1, 0], ["free", "ball"], np.array([[0, 0, 0], [0, -0.4, 0]], float)
)


@pytest.mark.parametrize("order", ORDERS)
def test_angles_are_scipy_s(order, rng):
    quaternions = rng.normal(size=(50, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    expected = Rotation.from_quat(np.roll(quaternions, -1, 1)).as_euler(order.upper())
    np.testing.assert_allclose(euler_angles(jnp.asarray(quaternions), order), expected, atol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("sign", [-1, 1])
def test_gimbal_lock_keeps_the_rotation(order, sign):
    exact = Rotation.from_euler(order.upper(), [0.4, sign * np.pi / 2, 0.3])
    angles = np.asarray(euler_angles(jnp.asarray(np.roll(exact.as_quat(), 1)), order))
    assert abs(angles[2]) < 1e-6
    again = Rotation.from_euler(order.upper(), angles)
    assert (again * exact.inv()).magnitude() < 1e-5


def test_a_knee_that_bends_on_past_half_a_turn_has_one_curve():
    bends = np.linspace(0, 4, 30)
    rotations = jax.vmap(lambda angle: rotation.about_axis(jnp.array([1.0, 0, 0]), angle))(jnp.asarray(bends))
    poses = jc.stack_poses([jc.rest_pose(CHAIN)] * 30).poses
    poses = jc.Pose(poses.translations, poses.rotations.at[:, 1].set(rotations), poses.scale)
    angles = jc.body.joint_euler_angles(CHAIN, jc.Motion(poses, 30.0), "xyz")
    np.testing.assert_allclose(angles[:, 1, 0], bends, atol=1e-5)
    assert np.abs(angles[:, 0]).max() == 0
    # in a frame whose x axis is the world's y, the same rotation is about minus its y
    frames = jnp.tile(jnp.asarray(np.roll(Rotation.from_euler("z", np.pi / 2).as_quat(), 1)), (2, 1))
    turned = jc.body.joint_euler_angles(CHAIN, poses, "yxz", frames)
    np.testing.assert_allclose(turned[:, 1, 0], -bends, atol=1e-5)


def test_derivatives_are_finite_at_rest():
    def bend(w):
        rotations = jnp.stack([rotation.identity(), rotation.exp(w)])
        return jc.body.joint_euler_angles(CHAIN, jc.Pose(jnp.zeros((2, 3)), rotations, jnp.ones(())), "xyz")[
            1
        ]

    np.testing.assert_allclose(jax.jacobian(bend)(jnp.zeros(3)), np.eye(3), atol=1e-6)


def test_wrong_orders_and_skeletons_are_refused():
    pose = jc.rest_pose(CHAIN)
    with pytest.raises(
        jc.InputError, match="joint_euler_angles: `order` is 'xyx'; expected three different axes"
    ):
        jc.body.joint_euler_angles(CHAIN, pose, "xyx")
    with pytest.raises(jc.InputError, match="`motion` has 1 joints; expected 2 as in `skeleton`"):
        jc.body.joint_euler_angles(
            CHAIN, jc.Pose(pose.translations[:1], pose.rotations[:1], pose.scale), "xyz"
        )


def test_derivatives_are_finite_in_exact_gimbal_lock():
    """The entries of the matrix are exactly zero and one, as no rounded rotation has them."""
    locked = jnp.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    for order, matrix in (
        ("xyz", locked),
        ("zxy", locked),
        ("yxz", locked.T),
        ("xzy", jnp.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])),
    ):
        for derivative in (jax.jacrev, jax.jacfwd):
            assert np.isfinite(
                derivative(lambda m, order=order: matrix_euler_angles(m, order))(matrix)
            ).all(), order
