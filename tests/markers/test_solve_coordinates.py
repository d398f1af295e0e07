"""Inverse kinematics by coordinates: known coordinates come back, ranges hold, and derivatives are those of differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxcap as jc
from jaxcap.body.coordinates.coordinate_model import follow_leaders
from jaxcap.energy.data.landmarks import VertexLandmarks
from jaxcap.fit.coordinate_problem import CoordinateProblem
from tests.io.osim.made_osim import joints, write_osim

FRAMES = 12


@pytest.fixture(scope="module")
def leg(tmp_path_factory):
    return jc.io.read_osim(write_osim(tmp_path_factory.mktemp("osim") / "leg.osim"))


def walk(model, turn=0.0):
    """Smooth coordinates, the whole turned about the vertical."""
    time = np.linspace(0, 1, FRAMES)
    values = np.tile(model.defaults, (FRAMES, 1))
    for name, course in {
        "rotation": turn + 0.2 * np.sin(3 * time),
        "tilt": 0.1 * np.cos(4 * time),
        "list": 0.05 * np.sin(5 * time),
        "tx": 1.2 * time,
        "tz": 0.1 * time,
        "flexion": 0.5 * np.sin(6 * time),
        "adduction": 0.1 * np.cos(5 * time),
        "turn": 0.1 * np.sin(2 * time),
        "knee": -0.9 + 0.8 * np.cos(6 * time),
        "ankle": 0.2 * np.sin(5 * time),
        "subtalar": 0.1 * np.cos(3 * time),
    }.items():
        values[:, model.index(name)] = course
    return np.array([follow_leaders(model, jnp.asarray(row)) for row in values])


def markers_of(leg, values):
    def places(row):
        return jc.markers.marker_positions(leg.markers, jc.body.pose_from_coordinates(leg.model, row))

    return np.array(jax.lax.map(places, jnp.asarray(values)))


def frames_of(leg, places, seen=None):
    places = np.array(places)
    if seen is not None:
        places[~seen] = np.nan
    return jc.make_markers(places, leg.markers.labels, 100.0)


@pytest.mark.parametrize("turn", [0.0, 2.5])
def test_coordinates_that_made_the_markers_come_back(leg, turn):
    values = walk(leg.model, turn)
    found = jc.markers.solve_coordinates(leg.model, leg.markers, frames_of(leg, markers_of(leg, values)))
    np.testing.assert_allclose(found.values, values, atol=1e-6)
    assert np.nanmax(found.markers.residuals) < 1e-6
    assert not found.markers.lost.any()
    np.testing.assert_allclose(
        found.markers.motion.poses.rotations, jc.body.motion_from_coordinates(leg.model, values, 100.0).poses.rotations, atol=1e-6
    )  # fmt: skip


def test_missing_markers_do_not_count_and_empty_frames_are_lost(leg):
    values = walk(leg.model)
    seen = np.ones((FRAMES, leg.markers.num_markers), bool)
    seen[:, leg.markers.labels.index("PATE")] = False
    seen[4, [0, 4, 7]] = False
    seen[7] = False
    found = jc.markers.solve_coordinates(
        leg.model, leg.markers, frames_of(leg, markers_of(leg, values), seen)
    )
    there = np.arange(FRAMES) != 7
    np.testing.assert_allclose(found.values[there], values[there], atol=1e-6)
    assert found.markers.lost.tolist() == (~there).tolist()
    np.testing.assert_array_equal(found.values[7], found.values[6])
    assert any("PATE" in said for said in found.markers.messages)


def test_ranges_and_locks_hold_and_are_told(leg, tmp_path):
    values = walk(leg.model)
    other = jc.io.read_osim(write_osim(tmp_path / "leg.osim", joints("-0.8 0.2", subtalar="true")))
    found = jc.markers.solve_coordinates(other.model, other.markers, frames_of(leg, markers_of(leg, values)))
    knee = found.values[:, other.model.index("knee")]
    assert knee.min() == pytest.approx(-0.8, abs=1e-9)
    assert (values[:, leg.model.index("knee")] < -0.85).any()
    np.testing.assert_array_equal(found.values[:, other.model.index("subtalar")], 0.05)
    assert any("knee in" in said and "ranges" in said for said in found.markers.messages)


def test_a_turning_person_has_no_jumps_between_chunks(leg):
    """600 frames, in chunks of 256, in which the heading turns by more than a whole turn."""
    model = leg.model
    values = np.tile(np.asarray(model.defaults), (600, 1))
    values[:, model.index("rotation")] = np.linspace(0, 9, 600)
    values[:, model.index("flexion")] = 0.4 * np.sin(np.linspace(0, 20, 600))
    found = jc.markers.solve_coordinates(model, leg.markers, frames_of(leg, markers_of(leg, values)))
    np.testing.assert_allclose(found.values, values, atol=1e-5)


def test_a_root_stays_in_its_range(leg, tmp_path):
    parts = joints()
    parts[0] = parts[0].replace(
        'name="rotation"><default_value>0</default_value><range>-3 3</range>\n<clamped>false',
        'name="rotation"><default_value>0</default_value><range>-1 1</range>\n<clamped>true',
    )
    other = jc.io.read_osim(write_osim(tmp_path / "leg.osim", parts))
    assert other.model.coordinates[other.model.index("rotation")].is_clamped
    places = markers_of(leg, walk(leg.model, turn=2.5))
    found = jc.markers.solve_coordinates(other.model, other.markers, frames_of(leg, places))
    assert np.abs(found.values[:, other.model.index("rotation")]).max() <= 1 + 1e-9


def test_a_target_of_a_coordinate_that_follows_moves_its_leader(leg):
    """The patella's angle is 0.9 times the knee's, and 0.02."""
    model = leg.model
    weights = np.zeros(len(model.names))
    weights[model.index("beta")] = 1e9
    targets = jc.body.CoordinateTargets(jnp.full(len(weights), -0.25), jnp.asarray(weights))
    frames = frames_of(leg, markers_of(leg, walk(model)))
    found = jc.markers.solve_coordinates(model, leg.markers, frames, targets=targets)
    np.testing.assert_allclose(found.values[:, model.index("knee")], -0.3, atol=1e-4)


def test_a_minimum_is_one_by_scipy(leg):
    """Noisy markers: SciPy's trust region finds the same coordinates."""
    from scipy.optimize import least_squares

    values = walk(leg.model)[5]
    places = markers_of(leg, values[None])[0] + np.random.default_rng(3).normal(0, 0.01, (12, 3))
    found = jc.markers.solve_coordinates(leg.model, leg.markers, frames_of(leg, places[None])).values[0]
    free = leg.model.free
    predict = jax.jit(
        lambda row: jc.markers.marker_positions(leg.markers, jc.body.pose_from_coordinates(leg.model, row))
    )

    def residual(x):
        return np.asarray(predict(jnp.asarray(values).at[free].set(x)) - places).reshape(-1)

    low, high = leg.model.bounds
    best = least_squares(
        residual, values[free], bounds=(low[free], high[free]), xtol=1e-14, ftol=1e-14, gtol=1e-14
    )
    np.testing.assert_allclose(found[free], best.x, atol=2e-4)
    assert np.square(residual(found[free])).sum() == pytest.approx(2 * best.cost, rel=1e-6)


def test_derivatives_are_those_of_differences(leg, rng):
    model = leg.model
    body = jc.markers.marker_body(leg.markers)
    targets = jc.body.CoordinateTargets(
        jnp.zeros(len(model.names)), jnp.asarray(rng.uniform(size=len(model.names)))
    )
    landmarks = VertexLandmarks(jnp.arange(12), jnp.asarray(rng.normal(size=(12, 3))), jnp.ones(12))
    free = jnp.asarray(np.isin(np.arange(len(model.names)), model.free))
    problem = CoordinateProblem(landmarks, model, body, free, targets)
    y = jnp.asarray(walk(model)[3])
    jacobian = np.asarray(problem.linearise(y)[1])
    for number in range(len(model.names)):
        step = 1e-6 * np.eye(len(model.names))[number]
        ends = [
            np.asarray(problem.residual(problem.retract(y, jnp.asarray(sign * step)))) for sign in (1, -1)
        ]
        np.testing.assert_allclose(jacobian[:, number], (ends[0] - ends[1]) / 2e-6, atol=1e-7)
    # a coordinate that follows another one is not free
    assert not np.any(jacobian[:, model.index("beta")])


def test_targets_hold_a_coordinate(leg):
    values = walk(leg.model)
    weights = np.zeros(len(leg.model.names))
    weights[leg.model.index("ankle")] = 1e9
    targets = jc.body.CoordinateTargets(jnp.full(len(weights), 0.3), jnp.asarray(weights))
    frames = frames_of(leg, markers_of(leg, values))
    found = jc.markers.solve_coordinates(leg.model, leg.markers, frames, targets=targets)
    np.testing.assert_allclose(found.values[:, leg.model.index("ankle")], 0.3, atol=1e-4)


def test_a_subject_of_another_skeleton_is_refused(leg, tmp_path):
    pin = jc.io.read_osim(write_osim(tmp_path / "leg.osim", joints()[:2], "", "")).model
    with pytest.raises(jc.InputError, match="another skeleton than the model"):
        jc.markers.solve_coordinates(pin, leg.markers, frames_of(leg, markers_of(leg, walk(leg.model))))
