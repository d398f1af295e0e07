"""Residuals of markers against autodiff and against what cannot be otherwise."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import retract
from jaxcap.markers.calibration.residuals import linearise_residuals, marker_residuals, residual_equations
from jaxcap.markers.subject import make_subject, marker_positions
from tests.helpers import chain_skeleton

_linearise = eqx.filter_jit(linearise_residuals)
_marker_places = eqx.filter_jit(marker_positions)
_residuals = eqx.filter_jit(marker_residuals)


@eqx.filter_jit
def _equations(subject, pose, places, weights):
    return residual_equations(subject, pose, places, lambda squared: weights)


def subject_of(models: tuple[str, ...], rng):
    skeleton = chain_skeleton()
    bones = np.array([0, 1, 2, 4, 5, 5, 6, 7, 8])
    offsets = np.asarray(skeleton.centres)[bones] + 0.06 * rng.normal(size=(9, 3))
    return make_subject(skeleton, bones, offsets, [f"m{i}" for i in range(9)], models=models)


def posed(subject, rng):
    skeleton = subject.skeleton
    return retract(skeleton, rest_pose(skeleton), jnp.asarray(0.4 * rng.normal(size=skeleton.num_dofs)))


@eqx.filter_jit
def _autodiff(subject, pose, places, joints):
    def at(d, centres, offsets):
        skeleton = subject.skeleton
        moved = eqx.tree_at(
            lambda s: (s.skeleton.centres, s.offsets),
            subject,
            (skeleton.centres.at[np.array(joints)].add(centres.reshape(-1, 3)), subject.offsets + offsets),
        )
        return marker_residuals(moved, retract(skeleton, pose, d), places)

    count = subject.skeleton.num_dofs
    still = jnp.zeros(count), jnp.zeros(3 * len(joints)), jnp.zeros_like(subject.offsets)
    return jax.jacfwd(at, (0, 1, 2))(*still)


@pytest.mark.parametrize("models", [("rigid",) * 9, ("rigid", "circle", "sphere") * 3])
def test_derivatives_are_those_of_autodiff(models, rng):
    subject = subject_of(models, rng)
    pose = posed(subject, rng)
    places = _marker_places(subject, pose) + 0.02 * rng.normal(size=(9, 3))
    joints = tuple(range(1, subject.skeleton.num_joints))
    closed = _linearise(subject, pose, places, joints)
    by_pose, by_centres, by_offsets = _autodiff(subject, pose, places, joints)
    np.testing.assert_allclose(closed.residual, _residuals(subject, pose, places), atol=1e-14)
    np.testing.assert_allclose(closed.by_pose, by_pose, atol=1e-10)
    np.testing.assert_allclose(closed.by_centres, by_centres, atol=1e-10)
    own = np.asarray(by_offsets)[np.arange(9), :, np.arange(9)]
    np.testing.assert_allclose(closed.by_offset, own, atol=1e-10)


def test_a_marker_may_go_where_its_model_lets_it(rng):
    """Around its bone on a circle, anywhere around its joint on a sphere, and nowhere if rigid."""
    subject = subject_of(("circle",) * 9, rng)
    pose, skeleton = rest_pose(subject.skeleton), subject.skeleton
    start, end = np.asarray(skeleton.centres)[[1, 2]]
    line = (end - start) / np.linalg.norm(end - start)
    arm = np.asarray(subject.offsets[1]) - start
    turned = (
        arm * np.cos(2.0)
        + np.cross(line, arm) * np.sin(2.0)
        + line * (line @ arm) * (1 - np.cos(2.0))
        + start
    )
    places = subject.offsets.at[1].set(turned)
    for models in (("circle",) * 9, ("sphere",) * 9, ("rigid",) * 9):
        free = eqx.tree_at(lambda s: s.offsets, subject_of(models, rng), subject.offsets)
        residual = np.asarray(_residuals(free, pose, places))
        if models[0] == "rigid":
            assert np.linalg.norm(residual[1]) > 0.01
        else:
            np.testing.assert_allclose(residual, 0, atol=1e-12)


def test_subjects_say_what_is_wrong():
    skeleton = chain_skeleton()
    with pytest.raises(ValueError, match="'b' is on bone 12"):
        make_subject(skeleton, [0, 12], np.zeros((2, 3)), ["a", "b"])
    with pytest.raises(ValueError, match="occurs twice"):
        make_subject(skeleton, [0, 1], np.zeros((2, 3)), ["a", "a"])
    with pytest.raises(ValueError, match="one of each"):
        make_subject(skeleton, [0, 1], np.zeros((3, 3)), ["a", "b"])


@pytest.mark.parametrize("models", [("rigid",) * 9, ("rigid", "circle", "sphere") * 3])
@pytest.mark.parametrize("away", [0.0, 30.0])
def test_equations_are_products_of_the_rows(models, away, rng):
    subject = subject_of(models, rng)
    pose = posed(subject, rng)
    pose = eqx.tree_at(lambda p: p.translations, pose, pose.translations.at[0].add(away))
    places = _marker_places(subject, pose) + 0.02 * rng.normal(size=(9, 3))
    rows = _linearise(subject, pose, places)
    weights = rng.uniform(0.5, 2.0, 9)
    residual, gradient, matrix = _equations(subject, pose, places, weights)
    flat = np.asarray(rows.by_pose).reshape(27, -1)
    weighted = np.repeat(weights, 3)[:, None] * flat
    np.testing.assert_allclose(residual, rows.residual, atol=1e-12)
    np.testing.assert_allclose(gradient, weighted.T @ np.asarray(rows.residual).reshape(-1), atol=1e-10)
    np.testing.assert_allclose(matrix, weighted.T @ flat, atol=1e-10)
