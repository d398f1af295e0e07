"""Body models fitted to registered meshes: exact data, noise, missing vertices, one person or many."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_model, random_pose

import jaxcap as jc
from jaxcap.body.pose import stack_poses

MODEL = chain_model(rings=8, sides=8)


def meshes(rng, count=3, same=True, noise=0.0):
    """Meshes with their coefficients."""
    z = rng.normal(size=(1 if same else count, 4)) * np.ones((count, 1))
    poses = stack_poses([random_pose(MODEL.template.skeleton, rng, 0.4) for _ in range(count)], 30.0).poses
    vertices = [
        np.asarray(
            jc.pose_body(
                jc.shape_body(MODEL, z[k]), jc.Pose(poses.translations[k], poses.rotations[k], poses.scale[k])
            ).vertices
        )
        for k in range(count)
    ]
    vertices = np.array(vertices) + noise * rng.normal(size=np.shape(vertices))
    return jc.MeshSequence(jnp.asarray(vertices), MODEL.template.faces, 30.0), z, poses


@pytest.mark.parametrize("same", [True, False])
def test_exact_meshes_give_back_their_parameters(rng, same):
    sequence, z, poses = meshes(rng, same=same)
    fit = jc.fit_model(MODEL, sequence, same_person=same)
    assert np.all(fit.converged)
    np.testing.assert_allclose(fit.rmse, 0.0, atol=1e-5)
    np.testing.assert_allclose(fit.coefficients, z, atol=1e-3)
    turned = np.abs(np.sum(np.asarray(fit.motion.poses.rotations) * np.asarray(poses.rotations), -1))
    np.testing.assert_allclose(turned, 1.0, atol=1e-5)


def test_noise_stays_in_the_residual_and_all_vertices_count(rng):
    sequence, z, _ = meshes(rng, noise=0.002)
    fit = jc.fit_model(MODEL, sequence)
    assert np.all(fit.converged)
    # of 192 vertices with three coordinates some are explained by the parameters
    np.testing.assert_allclose(fit.rmse, 0.002 * 3**0.5, rtol=0.15)
    np.testing.assert_allclose(fit.coefficients[0], z[0], atol=0.05)
    np.testing.assert_array_equal(fit.coefficients[0], fit.coefficients[2])


def test_missing_vertices_do_not_count(rng):
    sequence, z, _ = meshes(rng)
    vertices = np.array(sequence.vertices)
    vertices[0, 10:30] = np.nan
    vertices[2] = np.nan
    fit = jc.fit_model(MODEL, jc.MeshSequence(jnp.asarray(vertices), sequence.faces, 30.0), same_person=False)
    np.testing.assert_array_equal(fit.converged, [True, True, False])
    np.testing.assert_allclose(fit.coefficients[:2], z[:2], atol=1e-3)
    assert np.isnan(fit.rmse[2])
    assert np.isfinite(np.asarray(fit.motion.poses.rotations)).all()


def test_further_terms_are_those_of_all_vertices(rng):
    """A landmark on a vertex that the first fit does not have, at its true place, changes nothing."""
    sequence, z, _ = meshes(rng, count=1)
    vertex = len(MODEL.template.vertices) - 1
    term = jc.VertexLandmarks(
        jnp.array([vertex]), jnp.asarray(sequence.vertices[0, vertex])[None], jnp.array([1e6])
    )
    fit = jc.fit_model(MODEL, sequence, terms=term)
    assert np.all(fit.converged)
    np.testing.assert_allclose(fit.rmse, 0.0, atol=1e-5)
    np.testing.assert_allclose(fit.coefficients, z, atol=1e-3)


def test_meshes_of_another_body_are_told(rng):
    sequence, *_ = meshes(rng)
    fewer = jc.MeshSequence(sequence.vertices[:, :50], jnp.zeros((0, 3), int), 30.0)
    with pytest.raises(jc.InputError, match="The meshes have 50 vertices; expected the 192"):
        jc.fit_model(MODEL, fewer)
    with pytest.raises(jc.InputError, match="There is no mesh to fit"):
        jc.fit_model(MODEL, jc.MeshSequence(sequence.vertices[:0], sequence.faces, 30.0))


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        (None, "`sequence` is traced by jit, grad or vmap"),
        ("given", "the steps of this fit have no derivatives"),
    ],
)
def test_derivatives_are_refused_in_a_sentence(rng, start, reason):
    sequence, _, poses = meshes(rng)
    start = None if start is None else poses

    def first(vertices):
        moved = jc.MeshSequence(vertices, sequence.faces, 30.0)
        return jc.fit_model(MODEL, moved, start=start).coefficients[0, 0]

    with pytest.raises(jc.InputError, match=reason):
        jax.grad(first)(sequence.vertices)


def test_starts_are_one_for_each_mesh(rng):
    sequence, _, poses = meshes(rng)
    one = jc.Pose(poses.translations[0], poses.rotations[0], poses.scale[0])
    with pytest.raises(jc.InputError, match="`start` is a single pose; expected one for each of 3 meshes"):
        jc.fit_model(MODEL, sequence, start=one)
