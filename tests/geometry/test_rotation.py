"""Rotations against SciPy, finite differences and the facts of the group."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxcap.geometry import rotation

exp, log = jax.jit(rotation.exp), jax.jit(rotation.log)
to_matrix, from_matrix = jax.jit(rotation.to_matrix), jax.jit(rotation.from_matrix)
swing_twist, shortest_arc = jax.jit(rotation.swing_twist), jax.jit(rotation.shortest_arc)

#: angles where formulas branch: none, under and over the series' bound, ordinary, at pi
ANGLES = [0.0, 1e-12, 1e-8, 9.9e-4, 1.01e-3, 0.3, 2.0, np.pi - 1e-3, np.pi - 1e-7, np.pi]

numbers = st.floats(-1.0, 1.0)
directions = st.tuples(numbers, numbers, numbers).map(np.array).filter(lambda v: np.linalg.norm(v) > 1e-2)
angles = st.one_of(st.sampled_from(ANGLES), st.floats(0.0, np.pi))


def unit(v) -> jax.Array:
    return jnp.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


@given(directions, angles)
def test_exp_and_log_agree_with_scipy_and_invert_each_other(direction, angle):
    w = angle * unit(direction)
    q = exp(w)
    np.testing.assert_allclose(to_matrix(q), Rotation.from_rotvec(np.array(w)).as_matrix(), atol=1e-14)
    back = np.asarray(log(q))
    # at pi both `w` and `-w` are right
    sign = np.sign(back @ np.asarray(w)) if angle > np.pi - 1e-9 else 1.0
    np.testing.assert_allclose(sign * back, w, atol=2e-14)


@given(directions, angles)
def test_both_signs_of_a_quaternion_are_one_rotation(direction, angle):
    q = exp(angle * unit(direction))
    axis = unit(np.array([0.3, -0.5, 0.8]))
    np.testing.assert_array_equal(to_matrix(q), to_matrix(-q))
    turned, other = exp(log(q)), exp(log(-q))
    assert float(rotation.distance(turned, q)) < 1e-7
    assert float(rotation.distance(turned, other)) < 1e-7
    one, two = rotation.angle_about(q, axis), rotation.angle_about(-q, axis)
    np.testing.assert_allclose(np.exp(1j * np.asarray(one)), np.exp(1j * np.asarray(two)), atol=1e-12)


@pytest.mark.parametrize("angle", ANGLES)
def test_matrices_and_quaternions_convert_on_all_four_branches(angle):
    # each axis in turn makes another component the largest where the angle is large
    for axis in [*np.eye(3), *-np.eye(3), np.array([1.0, -1.0, 1.0]), np.array([1e-5, 1.0, -1e-5])]:
        expected = Rotation.from_rotvec(angle * np.array(unit(axis)))
        q = from_matrix(jnp.asarray(expected.as_matrix()))
        np.testing.assert_allclose(to_matrix(q), expected.as_matrix(), atol=1e-14)
        assert float(jnp.linalg.norm(q)) == pytest.approx(1.0, abs=1e-15)
        assert float(q[0]) >= 0.0


def test_composition_inverse_and_turning_agree_with_scipy(rng):
    a, b = (Rotation.random(20, random_state=seed) for seed in (1, 2))
    qa, qb = (jnp.asarray(r.as_quat(scalar_first=True)) for r in (a, b))
    x = rng.normal(size=(20, 3))
    np.testing.assert_allclose(to_matrix(rotation.multiply(qa, qb)), (a * b).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(to_matrix(rotation.conjugate(qa)), a.inv().as_matrix(), atol=1e-14)
    np.testing.assert_allclose(rotation.rotate(qa, jnp.asarray(x)), a.apply(x), atol=1e-14)
    np.testing.assert_allclose(rotation.distance(qa, qb), (a.inv() * b).magnitude(), atol=1e-13)
    np.testing.assert_allclose(
        jnp.einsum("nab,nb->na", rotation.skew(jnp.asarray(x)), qa[:, 1:]), np.cross(x, qa[:, 1:])
    )


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_derivatives_are_right_where_formulas_branch(mode):
    slope_exp, slope_log = (
        jax.jit(mode(rotation.exp)),
        jax.jit(mode(lambda q: rotation.log(rotation.normalise(q)))),
    )
    axis = unit(np.array([0.4, -0.2, 0.7]))
    step = 1e-6 * np.eye(3)
    for angle in ANGLES:
        w = angle * axis
        numeric = np.stack([(exp(w + s) - exp(w - s)) / 2e-6 for s in step], 1)
        np.testing.assert_allclose(slope_exp(w), numeric, atol=1e-9)
        if angle < np.pi - 1e-6:  # at pi the logarithm jumps
            # log(exp(w) exp(d)) has the inverse of the right Jacobian for its derivative
            by_update = slope_log(exp(w)) @ np.stack(
                [rotation.multiply(exp(w), jnp.append(0.0, e)) / 2 for e in np.eye(3)], 1
            )
            np.testing.assert_allclose(by_update @ rotation.right_jacobian(w), np.eye(3), atol=1e-8)
        assert np.isfinite(slope_log(exp(w))).all()


def test_derivatives_of_every_order_are_finite_at_rest_and_at_half_turns():
    axis = jnp.array([0.0, 0.6, 0.8])
    functions = {
        "exp": lambda w: rotation.exp(w),
        "log": lambda w: rotation.log(rotation.exp(w)),
        "angle": lambda w: rotation.angle_about(rotation.exp(w), axis)[None],
        "swing": lambda w: rotation.swing_twist(rotation.exp(w), axis)[0],
        "twist": lambda w: rotation.swing_twist(rotation.exp(w), axis)[1],
        "right": lambda w: rotation.right_jacobian(w),
    }
    places = [
        jnp.zeros(3),
        1e-9 * axis,
        jnp.pi * axis,
        jnp.pi * jnp.array([1.0, 0.0, 0.0]),
        jnp.pi * jnp.array([0.0, 0.8, -0.6]),
    ]

    @jax.jit
    def orders(w):
        return {
            name: (jax.jacfwd(f)(w), jax.jacrev(f)(w), jax.jacfwd(jax.jacrev(f))(w))
            for name, f in functions.items()
        }

    for place in places:
        for name, (forward, reverse, second) in orders(place).items():
            np.testing.assert_allclose(forward, reverse, atol=1e-12, err_msg=name)
            assert np.isfinite(forward).all(), name
            assert np.isfinite(second).all(), name


def test_second_derivative_at_rest_is_that_of_the_half_angle():
    # exp(w) = 1 - |w|^2 / 8 + w / 2 + O(|w|^3)
    second = jax.jit(jax.jacfwd(jax.jacrev(rotation.exp)))(jnp.zeros(3))
    np.testing.assert_allclose(second[0], -np.eye(3) / 4, atol=1e-15)
    np.testing.assert_allclose(second[1:], 0.0, atol=1e-15)


@given(directions, angles, directions)
def test_swing_times_twist_is_the_whole(direction, angle, axis):
    q, axis = exp(angle * unit(direction)), unit(axis)
    swing, twist = swing_twist(q, axis)
    np.testing.assert_allclose(to_matrix(rotation.multiply(swing, twist)), to_matrix(q), atol=1e-12)
    # the twist keeps its axis, and the swing turns about a perpendicular of it
    np.testing.assert_allclose(rotation.rotate(twist, axis), axis, atol=1e-12)
    assert abs(float(swing[1:] @ axis)) < 1e-9


def test_the_angle_of_a_turn_about_its_own_axis_is_that_angle():
    axis = jnp.tile(unit(np.array([1.0, 2.0, -0.5])), (21, 1))
    turns = jnp.linspace(-3.1, 3.1, 21)
    np.testing.assert_allclose(
        rotation.angle_about(rotation.about_axis(axis, turns), axis), turns, atol=1e-14
    )
    np.testing.assert_allclose(rotation.about_axis(axis, turns), exp(turns[:, None] * axis), atol=1e-14)


@pytest.mark.parametrize("angle", ANGLES)
def test_right_jacobian_against_finite_differences(angle):
    w = angle * unit(np.array([-0.3, 0.9, 0.4]))
    step = 1e-5 * np.eye(3)
    relative = lambda s: log(rotation.multiply(rotation.conjugate(exp(w)), exp(w + s)))  # noqa: E731
    numeric = np.stack([(relative(s) - relative(-s)) / 2e-5 for s in step], 1)
    np.testing.assert_allclose(rotation.right_jacobian(w), numeric, atol=1e-9)


def test_shortest_arc_turns_one_vector_onto_the_other(rng):
    a, b = unit(rng.normal(size=(50, 3))), unit(rng.normal(size=(50, 3)))
    q = shortest_arc(a, b)
    np.testing.assert_allclose(rotation.rotate(q, a), b, atol=1e-14)
    angle = np.arccos(np.clip(np.sum(a * b, 1), -1, 1))
    np.testing.assert_allclose(np.linalg.norm(log(q), axis=1), angle, atol=1e-7)
    same, opposite = shortest_arc(a, a), shortest_arc(a, -a)
    np.testing.assert_allclose(same, np.tile([1.0, 0, 0, 0], (50, 1)), atol=1e-14)
    np.testing.assert_allclose(rotation.rotate(opposite, a), -a, atol=1e-14)


def test_slerp_ends_where_it_should_and_has_constant_speed():
    a, b = (jnp.asarray(r.as_quat(scalar_first=True)) for r in Rotation.random(2, random_state=3))
    shares = jnp.linspace(0.0, 1.0, 5)
    way = rotation.slerp(jnp.tile(a, (5, 1)), jnp.tile(b, (5, 1)), shares)
    np.testing.assert_allclose(to_matrix(way[0]), to_matrix(a), atol=1e-14)
    np.testing.assert_allclose(to_matrix(way[-1]), to_matrix(b), atol=1e-14)
    steps = rotation.distance(way[:-1], way[1:])
    np.testing.assert_allclose(steps, float(rotation.distance(a, b)) / 4, atol=1e-13)


@pytest.mark.float32
def test_single_precision_keeps_its_digits():
    """Within 4e-7 of SciPy's float64 for values, 2e-6 through a matrix and back."""
    for angle in ANGLES[:-2]:
        w = (angle * np.array([0.6, 0.0, 0.8])).astype(np.float32)
        q = exp(jnp.asarray(w))
        assert q.dtype == jnp.float32
        expected = Rotation.from_rotvec(w.astype(float))
        np.testing.assert_allclose(q, expected.as_quat(scalar_first=True), atol=4e-7)
        np.testing.assert_allclose(log(q), w, atol=1e-6)
        assert float(rotation.distance(from_matrix(to_matrix(q)), q)) < 2e-6
