"""Implicit surfaces of spheres: closed forms, slopes, the way home, and the nearest point inside."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxcap.limits.chart import Chart
from jaxcap.limits.primitives import LEVEL, STIFFNESS, Primitives, field, radii, signed_distance
from jaxcap.limits.project_onto_surface import project_inside

BALL = Chart(jnp.array([1.0, 0, 0, 0]), jnp.eye(3)[:2], "ball")


def one(thickness: float = 1.0, unit: float = 1.0) -> Primitives:
    return Primitives(jnp.zeros((1, 3)), jnp.array([thickness]), unit)


def several(rng, count: int = 30) -> Primitives:
    centres = jnp.asarray(rng.uniform(-0.4, 0.4, (count, 3)))
    return Primitives(centres, jnp.asarray(rng.uniform(0.08, 0.15, count)), 0.05)


def test_one_primitive_is_the_papers_equation_2():
    """Linear to the thickness, quadratic to the cut-off at e + 2/k, nothing beyond."""
    k, e = STIFFNESS, 1.0
    for d in (0.0, 0.3, 0.999, 1.0, 1.02, 1.0999, 1.1, 1.3):
        expected = -k * d + k * e + 1 if d <= e else (k * (d - e) - 2) ** 2 / 4 if d <= e + 2 / k else 0.0
        assert float(field(one(), jnp.array([0.0, d, 0.0]))) == pytest.approx(expected, abs=1e-12)


def test_the_distance_to_one_primitive_is_a_straight_line_for_ever():
    """Slope one inside, across the thickness and the cut-off, and far outside of the reach."""
    radius = float(radii(one())[0])
    assert radius == pytest.approx(1.0 - (LEVEL - 1) / STIFFNESS)
    for d in (0.1, 0.69, 0.7, 0.99, 1.0, 1.05, 1.1, 1.2, 5.0, 100.0):
        point = jnp.array([d, 0.0, 0.0])
        value, slope = jax.value_and_grad(lambda x: signed_distance(one(), x))(point)
        assert float(value) == pytest.approx(d - radius, abs=1e-9)
        np.testing.assert_allclose(slope, [1.0, 0.0, 0.0], atol=1e-9)


def test_slopes_against_central_differences_also_at_the_borders_of_primitives(rng):
    primitives = several(rng)
    value = jax.jit(lambda x: signed_distance(primitives, x))
    slope = jax.jit(jax.grad(value))
    reach = np.asarray(primitives.thickness)[:, None]
    step = 2 / STIFFNESS * primitives.unit
    away = Rotation.random(len(reach), random_state=0).apply([1.0, 0, 0])
    centres = np.asarray(primitives.centres)
    # on the thickness, on the cut-off, in the open, and far off
    points = [centres + away * (reach + edge) for edge in (0.0, step, step / 3, 1.0)]
    h = 1e-6
    for point in np.concatenate(points):
        found = [(value(point + h * axis) - value(point - h * axis)) / (2 * h) for axis in np.eye(3)]
        np.testing.assert_allclose(slope(point), found, atol=2e-3)


def test_value_and_slope_go_on_without_a_jump_where_the_nearest_primitive_changes():
    two = Primitives(jnp.array([[-1.0, 0, 0], [1.0, 0, 0]]), jnp.array([0.5, 0.5]), 1.0)
    slope = jax.jit(jax.grad(lambda x: signed_distance(two, x)))
    steps = np.linspace(-0.05, 0.05, 401)
    slopes = np.array([slope(jnp.array([x, 0.6, 0.0])) for x in steps])
    assert np.abs(np.diff(slopes, axis=0)).max() < 0.05
    # yet it does change from one side to the other
    assert slopes[0, 0] > 0.3 > -0.3 > slopes[-1, 0]


def test_outside_of_every_reach_the_slope_still_leads_home(rng):
    """Descent by the distance arrives, however many primitives lie on one place."""
    primitives = several(rng)
    many = Primitives(jnp.tile(primitives.centres, (300, 1)), jnp.tile(primitives.thickness, 300), 0.05)
    slope = jax.jit(jax.value_and_grad(lambda x: signed_distance(many, x)))
    for start in rng.normal(size=(10, 3)) * 3:
        point = jnp.asarray(start)
        for _ in range(60):
            value, direction = slope(point)
            if value <= 0:
                break
            assert np.linalg.norm(direction) > 0.1
            point = point - value * direction / jnp.sum(direction**2)
        assert float(slope(point)[0]) < 1e-3


def test_nothing_is_not_a_number_at_a_centre():
    value, slope = jax.value_and_grad(lambda x: signed_distance(one(), x))(jnp.zeros(3))
    assert np.isfinite(value)
    assert np.isfinite(slope).all()


def test_the_nearest_point_of_a_sphere_in_closed_form():
    """About the chart's middle, and for a small sphere anywhere, it lies on the way to the centre."""
    primitives = one(0.3, 0.1)
    point = jnp.array([0.2, 0.5, -0.1])
    found = np.asarray(project_inside(primitives, BALL, point))
    expected = np.asarray(point) / np.linalg.norm(point) * float(radii(primitives)[0])
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_the_nearest_point_is_inside_and_no_sample_of_the_surface_is_nearer(rng):
    primitives = several(rng)
    nearest = jax.jit(lambda x: project_inside(primitives, BALL, x))
    value = jax.jit(jax.vmap(lambda x: signed_distance(primitives, x)))
    dense = rng.uniform(-0.7, 0.7, (60000, 3))
    inside = dense[np.asarray(value(jnp.asarray(dense))) <= 0]
    apart = jax.jit(jax.vmap(BALL.squared_distance, (0, None)))
    for point in rng.uniform(-0.57, 0.57, (40, 3)):
        if value(jnp.asarray(point[None]))[0] <= 0:
            continue
        found = nearest(jnp.asarray(point))
        assert float(value(found[None])[0]) <= 0
        best = float(jnp.sqrt(apart(jnp.asarray(inside), jnp.asarray(point)).min()))
        assert float(jnp.sqrt(BALL.squared_distance(found, jnp.asarray(point)))) <= 1.1 * best + 0.01


@pytest.mark.float32
def test_the_nearest_point_is_inside_in_both_precisions(rng):
    primitives = jax.tree.map(lambda x: jnp.asarray(x, float), several(rng))
    points = jnp.asarray(rng.uniform(-0.57, 0.57, (200, 3)))
    found = jax.jit(jax.vmap(lambda x: project_inside(primitives, BALL, x)))(points)
    value = jax.vmap(lambda x: signed_distance(primitives, x))
    outside = value(points) > 0
    assert outside.any()
    assert (value(found)[outside] <= 0).all()


@pytest.mark.parametrize("kind", ["hinge", "universal", "ball"])
def test_charts_are_inverse_to_themselves(rng, kind):
    middle = Rotation.random(random_state=1).as_quat(scalar_first=True)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0].T[:2]
    chart = Chart(jnp.asarray(middle), jnp.asarray(axes), kind)
    places = rng.uniform(-0.5, 0.5, (50, 3)) * (np.arange(3) < chart.dimension)
    turned = jax.vmap(chart.rotation)(jnp.asarray(places))
    np.testing.assert_allclose(jax.vmap(chart.coordinates)(turned), places, atol=1e-9)
    np.testing.assert_allclose(jax.vmap(chart.coordinates)(-turned), places, atol=1e-9)


def test_distances_in_charts_are_half_angles(rng):
    middle = jnp.array([1.0, 0, 0, 0])
    for kind in ("hinge", "ball"):
        chart = Chart(middle, jnp.eye(3)[:2], kind)
        places = jnp.asarray(rng.uniform(-0.5, 0.5, (20, 3)) * (np.arange(3) < chart.dimension))
        turned = [Rotation.from_quat(np.asarray(chart.rotation(p)), scalar_first=True) for p in places]
        for a in range(0, 20, 2):
            half = (turned[a].inv() * turned[a + 1]).magnitude() / 2
            squared = float(chart.squared_distance(places[a], places[a + 1]))
            assert squared == pytest.approx(half**2 if kind == "hinge" else np.sin(half) ** 2, abs=1e-9)


def test_a_hinge_goes_back_the_shorter_way_round():
    chart = Chart(jnp.array([1.0, 0, 0, 0]), jnp.eye(3)[:2], "hinge")
    primitives = Primitives(jnp.array([[0.6, 0, 0]]), jnp.array([0.2]), 0.1)
    found = float(project_inside(primitives, chart, jnp.array([-1.4, 0.0, 0.0]))[0])
    assert found == pytest.approx(0.6 + float(radii(primitives)[0]), abs=0.01)
