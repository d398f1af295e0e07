"""Deviations of shape coefficients and joints against the dense normal equations, and by more or fewer clouds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body

import jaxcap as jc
from jaxcap.adapt.shape.shape_uncertainty import joint_deviations, shape_uncertainty
from jaxcap.body.body_model import BodyModel
from jaxcap.body.shape_modes import ShapeModes


@pytest.fixture(scope="module")
def scene():
    """A chain that may be longer or thicker, and clouds of its vertices in several poses."""
    rng = np.random.default_rng(3)
    body = chain_body()
    rest = np.asarray(body.vertices)
    middle = rest.mean(0)
    along = np.ptp(rest, axis=0).argmax()
    longer = np.zeros_like(rest)
    longer[:, along] = 0.1 * (rest - middle)[:, along]
    thicker = 0.1 * (rest - middle)
    thicker[:, along] = 0.0
    centres = np.zeros((2, body.skeleton.num_joints, 3))
    centres[0, :, along] = 0.1 * (np.asarray(body.skeleton.centres) - middle)[:, along]
    modes = ShapeModes(jnp.asarray(centres), jnp.asarray([longer, thicker]))
    model = BodyModel(body, modes, jnp.zeros(2))
    poses = jc.body.sample_poses(body.skeleton, count=4)
    clouds = []
    for frame in range(4):
        posed = jc.pose_body(body, jax.tree.map(lambda x, k=frame: x[k], poses))
        noise = 0.002 * rng.normal(size=rest.shape)
        clouds.append(jc.make_cloud(np.asarray(posed.vertices) + noise, np.asarray(posed.normals)))
    return model, clouds, [jax.tree.map(lambda x, k=k: x[k], poses) for k in range(4)]


def test_more_clouds_give_smaller_deviations(scene):
    model, clouds, poses = scene
    tracker = jc.make_tracker(model.template)
    one = shape_uncertainty(tracker, clouds[:1], poses[:1], model)
    four = shape_uncertainty(tracker, clouds, poses, model)
    np.testing.assert_allclose(one.coefficients, 0.0, atol=1e-6)
    assert (np.linalg.eigvalsh(np.asarray(four.covariance)) > 0).all()
    assert (np.asarray(four.deviations) < np.asarray(one.deviations)).all()


def test_joints_have_a_part_of_the_shape(scene):
    model, clouds, poses = scene
    tracker = jc.make_tracker(model.template)
    shape = shape_uncertainty(tracker, clouds, poses, model)
    found = joint_deviations(tracker, clouds[0], poses[0], shape, model)
    assert found.shape == (model.template.skeleton.num_joints,) and (found > 0).all()
    known = type(shape)(shape.coefficients, 0.0 * shape.covariance)
    assert (joint_deviations(tracker, clouds[0], poses[0], known, model) < found).all()


def test_clouds_and_poses_have_to_match(scene):
    model, clouds, poses = scene
    with pytest.raises(jc.InputError, match="there are 4 clouds and 3 poses"):
        shape_uncertainty(jc.make_tracker(model.template), clouds, poses[:3], model)
