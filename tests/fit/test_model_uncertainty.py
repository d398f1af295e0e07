"""Deviations of fitted body models against the covariance of linear least squares with known noise."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body

import jaxcap as jc
from jaxcap.body.body_model import BodyModel, shape_from_template
from jaxcap.body.retraction import retract
from jaxcap.body.shape_modes import ShapeModes
from jaxcap.fit.body_models.model_uncertainty import model_uncertainty

FRAMES, NOISE, REPEATS = 3, 0.003, 8
COEFFICIENTS = np.array([0.5, -0.5])


@pytest.fixture(scope="module")
def scene():
    """A chain that may be longer or thicker, its poses, and the surfaces of one person without noise."""
    body = chain_body()
    rest = np.asarray(body.vertices)
    off = 0.1 * (rest - rest.mean(0))
    along = np.ptp(rest, axis=0).argmax()
    longer, thicker = np.zeros_like(rest), off.copy()
    longer[:, along], thicker[:, along] = off[:, along], 0.0
    centres = np.zeros((2, body.skeleton.num_joints, 3))
    centres[0, :, along] = 0.1 * (np.asarray(body.skeleton.centres) - rest.mean(0))[:, along]
    modes = ShapeModes(jnp.asarray(centres), jnp.asarray([longer, thicker]))
    model = BodyModel(body, modes, jnp.zeros(2), (("betas", 2),))
    poses = jc.body.sample_poses(body.skeleton, count=FRAMES)
    shaped = jc.shape_body(model, betas=COEFFICIENTS)
    return model, poses, np.asarray(jc.body.posed_vertices(shaped, poses))


def linear_covariance(model, poses, same_person):
    """Deviations of the coefficients and joints of each mesh, from Jacobians by automatic differentiation."""
    dofs, frames = model.template.skeleton.num_dofs, len(poses.scale)

    def placed(x, pose):
        body = shape_from_template(model, COEFFICIENTS + x[dofs:])
        posed = jc.pose_body(body, retract(body.skeleton, pose, x[:dofs]))
        return posed.vertices.reshape(-1), posed.joints

    # the unknowns of all frames, the coefficients last
    size = frames * dofs + 2
    columns = [[*range(k * dofs, (k + 1) * dofs), size - 2, size - 1] for k in range(frames)]
    slopes = [
        jax.jacfwd(placed)(jnp.zeros(dofs + 2), jax.tree.map(lambda x, k=k: x[k], poses))
        for k in range(frames)
    ]
    groups = [range(frames)] if same_person else [[k] for k in range(frames)]
    own, joints = np.zeros((frames, 2)), np.zeros((frames, model.template.skeleton.num_joints))
    for group in groups:
        matrix = np.zeros((size, size))
        for k in group:
            rows = np.asarray(slopes[k][0])
            matrix[np.ix_(columns[k], columns[k])] += rows.T @ rows
        covariance = NOISE**2 * np.linalg.pinv(matrix, rcond=1e-12)
        for k in group:
            own[k] = np.sqrt(np.diagonal(covariance)[-2:])
            block, by = covariance[np.ix_(columns[k], columns[k])], np.asarray(slopes[k][1])
            joints[k] = np.sqrt(np.einsum("jan,nm,jam->j", by, block, by))
    return own, joints


@pytest.mark.parametrize("same_person", [True, False])
def test_deviations_are_those_of_linear_least_squares(scene, same_person):
    model, poses, surfaces = scene
    rng, found = np.random.default_rng(4), []
    for _ in range(REPEATS):
        noisy = surfaces + NOISE * rng.normal(size=surfaces.shape)
        sequence = jc.MeshSequence(jnp.asarray(noisy), model.template.faces, 30.0)
        fit = jc.fit_model(model, sequence, same_person=same_person)
        found.append(model_uncertainty(model, sequence, fit, same_person=same_person))
    own, joints = linear_covariance(model, poses, same_person)
    mean = [
        np.sqrt(np.mean(np.array(each) ** 2, 0))
        for each in zip(*[(f.coefficients, f.joints) for f in found], strict=True)
    ]
    # a fit leaves less than the noise: 24 of 144 coordinates of a mesh are fitted
    np.testing.assert_allclose(mean[0], own, rtol=0.3)
    np.testing.assert_allclose(mean[0].mean(), own.mean(), rtol=0.15)
    np.testing.assert_allclose(mean[1].mean(1), joints.mean(1), rtol=0.25)


def test_exact_meshes_have_small_deviations_and_lost_ones_none(scene):
    model, _, surfaces = scene
    lost = np.array(surfaces)
    lost[1] = np.nan
    sequence = jc.MeshSequence(jnp.asarray(lost), model.template.faces, 30.0)
    known = model_uncertainty(model, sequence, jc.fit_model(model, sequence))
    assert np.isnan(known.joints[1]).all() and (known.joints[[0, 2]] < 1e-4).all()
    assert (known.coefficients < 1e-3).all()
