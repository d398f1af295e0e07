"""What is known of how far human joints turn, and the prior that is made of it."""

import jax.numpy as jnp
import numpy as np
from helpers import chain_body, check_energy, random_pose

from jaxcap.body.body import pose_body
from jaxcap.body.people.anatomy import DEVIATIONS, rest_deviations
from jaxcap.body.people.human import human
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.geometry import rotation


def test_human_joints_have_their_values_by_name():
    skeleton = human(resolution="low").skeleton
    found = rest_deviations(skeleton, default=9.0)
    assert np.isinf(found[skeleton.index("Hips")]).all()
    for name, plain in (
        ("LeftForeArm", "ForeArm"),
        ("RightForeArm", "ForeArm"),
        ("LThumb", "Thumb"),
        ("RThumb", "Thumb"),
        ("Head", "Head"),
    ):
        np.testing.assert_array_equal(found[skeleton.index(name)], DEVIATIONS[plain])
    # an elbow and a knee flex, and do not bend sideways
    for joint in ("LeftForeArm", "RightLeg"):
        twist, flexion, sideways = found[skeleton.index(joint)]
        assert flexion > 2 * twist > 2 * sideways
    # what anatomy does not name cannot turn: the carriers of the hips
    unknown = [skeleton.names[j] for j in np.flatnonzero((found == 9.0).all(1))]
    assert {skeleton.kinds[skeleton.index(name)] for name in unknown} == {"fixed"}


def test_other_skeletons_have_the_default():
    skeleton = chain_body().skeleton
    found = rest_deviations(skeleton, 0.7)
    assert np.isinf(found[0]).all()
    assert (found[1:] == 0.7).all()


def test_a_rest_prior_is_measured_in_the_joint_s_own_frame(rng):
    """A turn by 0.3 about a joint's own y axis is 0.3 over the deviation of flexion, only."""
    skeleton = human(resolution="low").skeleton
    deviations = jnp.asarray(rest_deviations(skeleton))
    joint = skeleton.index("LeftForeArm")
    own_y = rotation.rotate(skeleton.orientations[joint], jnp.array([0.0, 1.0, 0.0]))
    rest = rest_pose(skeleton)
    bent = rest.rotations.at[joint].set(rotation.about_axis(own_y, jnp.asarray(0.3)))
    # the root is free, wherever it turns
    bent = bent.at[0].set(rotation.normalise(jnp.asarray(rng.normal(size=4))))
    posed = pose_body(human(resolution="low"), Pose(rest.translations, bent, rest.scale))
    residual = np.asarray(RestPrior(deviations).residual(posed)).reshape(-1, 3)
    expected = np.zeros_like(residual)
    expected[joint, 1] = 0.3 / 1.2
    np.testing.assert_allclose(residual, expected, atol=1e-6)


def test_a_rest_prior_against_central_differences(rng):
    """At rest and half turned too, where a rotation vector has its corners."""
    body = chain_body()
    deviations = jnp.asarray(rng.uniform(0.3, 2.0, (body.skeleton.num_joints, 3))).at[0].set(jnp.inf)
    check_energy(RestPrior(deviations), body, [random_pose(body.skeleton, rng, 0.8)])
