"""Dual quaternions against 4 x 4 matrices, and the facts that blending rests on."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxcap.geometry import dual_quaternions

finite = st.floats(-3.0, 3.0)
triples = st.tuples(finite, finite, finite)


motion = jax.jit(dual_quaternions.from_rigid)


def rigid(w, t):
    """A motion as a dual quaternion and as a matrix and a shift, the matrix by SciPy."""
    turn = Rotation.from_rotvec(np.array(w))
    return motion(jnp.asarray(turn.as_quat(scalar_first=True)), jnp.array(t)), turn.as_matrix(), np.array(t)


multiply, conjugate, normalise = (
    jax.jit(f) for f in (dual_quaternions.multiply, dual_quaternions.conjugate, dual_quaternions.normalise)
)
apply, about_centre = jax.jit(dual_quaternions.apply), jax.jit(dual_quaternions.about_centre)


@given(triples, triples, triples, triples, triples)
def test_they_move_points_as_matrices_do(w, t, u, s, x):
    (a, ra, ta), (b, rb, tb) = rigid(w, t), rigid(u, s)
    x = np.array(x)
    np.testing.assert_allclose(apply(a, jnp.asarray(x)), ra @ x + ta, atol=1e-13)
    np.testing.assert_allclose(apply(multiply(a, b), jnp.asarray(x)), ra @ (rb @ x + tb) + ta, atol=1e-13)
    np.testing.assert_allclose(multiply(a, conjugate(a)), np.eye(8)[0], atol=1e-14)
    np.testing.assert_allclose(apply(-a, jnp.asarray(x)), ra @ x + ta, atol=1e-13)
    # a multiple is the same motion, and normalised it is `a` again
    for size in (0.3, 4.0):
        np.testing.assert_allclose(apply(size * a, jnp.asarray(x)), ra @ x + ta, atol=1e-13)
        np.testing.assert_allclose(normalise(size * a), a, atol=1e-13)


@given(triples, triples)
def test_a_turn_about_a_centre_leaves_it_in_place(w, c):
    d = about_centre(jnp.asarray(Rotation.from_rotvec(np.array(w)).as_quat(scalar_first=True)), jnp.array(c))
    np.testing.assert_allclose(apply(d, jnp.array(c)), c, atol=1e-14)


def test_a_blend_is_normalised_as_eq_3_17_has_it(rng):
    """`apply` leaves out what the dual norm takes away: same motion, and a rigid one."""
    duals = jnp.stack([rigid(0.5 * rng.normal(size=3), rng.normal(size=3))[0] for _ in range(4)])
    blend = jnp.asarray(rng.dirichlet(np.ones(4))) @ duals
    unit = normalise(blend)
    np.testing.assert_allclose(jnp.sum(unit[:4] ** 2), 1.0, atol=1e-14)
    np.testing.assert_allclose(jnp.sum(unit[:4] * unit[4:]), 0.0, atol=1e-14)
    points = jnp.asarray(rng.normal(size=(5, 3)))
    moved = jax.vmap(apply, (None, 0))(blend, points)
    np.testing.assert_allclose(moved, jax.vmap(apply, (None, 0))(unit, points), atol=1e-13)
    apart = lambda x: np.linalg.norm(x[:, None] - x[None], axis=-1)  # noqa: E731
    np.testing.assert_allclose(apart(np.asarray(moved)), apart(np.asarray(points)), atol=1e-13)


def test_signs_follow_the_largest_weight(rng):
    """Blends do not depend on the signs of what is blended, up to their own."""
    motions = jnp.stack([rigid(2.0 * rng.normal(size=3), rng.normal(size=3))[0] for _ in range(5)])
    weights = jnp.asarray(rng.dirichlet(np.ones(5), size=20))
    flipped = motions * jnp.asarray(rng.choice([-1.0, 1.0], size=(5, 1)))
    points = jnp.asarray(rng.normal(size=(20, 3)))
    places = [
        dual_quaternions.apply(dual_quaternions.align(weights, some) @ some, points)
        for some in (motions, flipped)
    ]
    np.testing.assert_allclose(*places, atol=1e-13)
    for row, signed in zip(
        np.asarray(weights), np.asarray(dual_quaternions.align(weights, motions)), strict=True
    ):
        leader = np.asarray(motions)[row.argmax(), :4]
        expected = [np.copysign(w, m[:4] @ leader) for w, m in zip(row, np.asarray(motions), strict=True)]
        np.testing.assert_array_equal(signed, expected)


def test_rates_of_a_motion_that_is_carried_along(rng):
    """`from_twist(a, b) d` is the derivative of `exp(h a), h b` after `d`."""
    a, b, step = rng.normal(size=3), rng.normal(size=3), 1e-6
    d = rigid(rng.normal(size=3), rng.normal(size=3))[0]
    x = jnp.asarray(rng.normal(size=3))
    ahead, behind = (multiply(rigid(h * a, h * b)[0], d) for h in (step, -step))
    rate = dual_quaternions.multiply(dual_quaternions.from_twist(jnp.asarray(np.concatenate([a, b]))), d)
    np.testing.assert_allclose(rate, (ahead - behind) / (2 * step), atol=1e-9)
    # and it moves points along the field
    moved = jax.jvp(lambda d: dual_quaternions.apply(d, x), (d,), (rate,))
    np.testing.assert_allclose(moved[1], np.cross(a, moved[0]) + b, atol=1e-13)


def test_the_closed_form_of_the_pull_back_is_autodiff(rng):
    d, x, m = (jnp.asarray(rng.normal(size=shape)) for shape in ((30, 8), (30, 3), (30, 2, 3)))
    slopes = jax.vmap(jax.jacfwd(dual_quaternions.apply))(d, x)
    np.testing.assert_allclose(
        dual_quaternions.pull_back(d, x, m), jnp.einsum("vra,vak->vrk", m, slopes), atol=1e-11
    )


def test_a_row_without_weights_is_finite():
    value, slope = jax.value_and_grad(lambda d: dual_quaternions.apply(d, jnp.ones(3)).sum())(jnp.zeros(8))
    assert np.isfinite(value)
    assert np.isfinite(slope).all()
