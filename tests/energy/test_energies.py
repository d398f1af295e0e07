"""Every energy against central differences, and what zero weights and limits do."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, check_energy, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body.body import pose_body
from jaxcap.body.pose import rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.data.landmarks import BoneLandmarks, VertexLandmarks, joint_landmarks
from jaxcap.energy.data.points import PointToPlane, PointToPoint
from jaxcap.energy.data.sufficient_statistics import rigid_moments
from jaxcap.energy.energy import energies
from jaxcap.energy.priors.joint_limits import JointLimits
from jaxcap.energy.priors.reference_pose import PosePrior, ReferencePrior, RestPrior
from jaxcap.geometry import rotation
from jaxcap.limits.ranges_and_cones import Cone, make_joint_ranges
from tests.kineben import cone_gradient

BODY = chain_body()
SKELETON = BODY.skeleton
LIMITS = make_joint_ranges(
    SKELETON,
    {"elbow": (-0.3, 0.2), "spine": ((-0.1, 0.4), (-0.2, 0.3)), "jaw": (-0.5, 0.6)},
    {"chest": Cone((1, 0, 0), 0.3, (0, 1, 0), 0.2), "hand": Cone((0, 1, 1), 0.5, (1, 0, 0), 2.0)},
)


@eqx.filter_jit
def residual_of(energy, body, pose, d=None):
    return energy.residual(pose_body(body, pose if d is None else retract(body.skeleton, pose, d)))


@eqx.filter_jit
def value_of(energy, body, pose):
    return jnp.sum(energy.residual(pose_body(body, pose)) ** 2)


@eqx.filter_jit
def slope_of(energy, body, pose):
    return jax.jacfwd(lambda d: residual_of(energy, body, pose, d))(jnp.zeros(body.skeleton.num_dofs))


@eqx.filter_jit
@eqx.filter_grad
def sensitivity(energy, body, pose):
    """The gradient of an energy's value to all that it holds."""
    return value_of(energy, body, pose)


def some_pairs(rng, count: int = 12):
    """Vertices, points near them, unit directions, and weights of which some are zero."""
    chosen = jnp.asarray(rng.integers(0, len(BODY.vertices), count))
    points = jnp.asarray(BODY.vertices[chosen] + 0.1 * rng.normal(size=(count, 3)))
    normals = rng.normal(size=(count, 3))
    normals = jnp.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))
    weights = jnp.asarray(rng.uniform(0.1, 2.0, count)).at[:3].set(0.0)
    return chosen, points, normals, weights


def some_reference_prior(rng) -> ReferencePrior:
    """About an ordinary pose; one joint slides freely, and one turns freely."""
    metres = jnp.asarray(rng.uniform(0.5, 2.0, 9)).at[3].set(jnp.inf)
    radians = jnp.asarray(rng.uniform(0.5, 2.0, (9, 3))).at[5].set(jnp.inf)
    return ReferencePrior(random_pose(SKELETON, rng, 0.4), metres, radians)


def test_distances_landmarks_and_priors_against_central_differences(rng):
    chosen, points, normals, weights = some_pairs(rng)
    bones = BODY.skin.dominant_bones()[chosen]
    deviations = jnp.asarray(rng.uniform(0.5, 2.0, SKELETON.num_dofs)).at[2].set(jnp.inf)
    total = (
        PointToPoint(chosen, points, weights)
        + PointToPlane(chosen, points, normals, weights)
        + 2.0 * VertexLandmarks(chosen, points, weights)
        + BoneLandmarks(bones, BODY.vertices[chosen], points, weights)
        + 0.0 * joint_landmarks(SKELETON.centres + 0.1)
        + rigid_moments(bones, BODY.vertices[chosen], points, weights, SKELETON.num_joints)
        + PosePrior(random_pose(SKELETON, rng, 0.5), deviations)
        + some_reference_prior(rng)
        + RestPrior(jnp.asarray(rng.uniform(0.5, 2.0, (9, 3))))
    )
    check_energy(total, BODY, [random_pose(SKELETON, rng, 0.8, scale=1.2)])


def test_the_reference_prior_is_measured_about_the_joints_own_axes(rng):
    """Against SciPy's rotations."""
    prior, pose = some_reference_prior(rng), random_pose(SKELETON, rng, 0.4)
    quaternions = (prior.reference.rotations, pose.rotations, SKELETON.orientations)
    here, there, own = (Rotation.from_quat(np.asarray(q), scalar_first=True) for q in quaternions)
    turns = own.inv().apply((here.inv() * there).as_rotvec()) / prior.radians
    shifts = (pose.translations - prior.reference.translations) / prior.metres[:, None]
    expected = np.concatenate([shifts.ravel(), turns.ravel()])
    np.testing.assert_allclose(residual_of(prior, BODY, pose), expected, atol=1e-9)


def test_joint_limits_against_central_differences_and_their_closed_form(rng):
    """Slope one beyond a range (Kineben, eq. 14), eq. 16 beyond a cone, nothing inside."""
    energy, layout = JointLimits(LIMITS), dof_layout(SKELETON)

    def analytic(posed):
        rows = [
            np.eye(SKELETON.num_dofs)[layout.rotations[j, n]]
            for j, n in zip(LIMITS.joints, LIMITS.angle_indices, strict=True)
        ]
        for axes in (LIMITS.heading, LIMITS.bank):
            for joint, axis in zip(np.asarray(LIMITS.ball_joints), axes, strict=True):
                row = np.zeros(SKELETON.num_dofs)
                row[layout.rotations[joint]] = cone_gradient(
                    axis, rotation.to_matrix(posed.pose.rotations[joint])
                )
                rows.append(row)
        beyond = np.asarray(energy.residual(posed)) != 0
        seen.append(beyond)
        return np.where(beyond[:, None], np.array(rows), 0.0)

    seen = []
    check_energy(energy, BODY, [random_pose(SKELETON, rng, 0.7) for _ in range(6)], analytic)
    assert np.any(seen, axis=0).all(), "some limit was never passed"
    assert not np.all(seen, axis=0).any(), "some limit was always passed"


def test_on_a_limit_there_is_no_residual_and_a_finite_slope():
    layout = dof_layout(SKELETON)
    elbow, chest = SKELETON.index("elbow"), layout.rotations[SKELETON.index("chest")]
    energy = JointLimits(LIMITS)
    for slot, edges in ((layout.rotations[elbow, 0], (-0.3, 0.2)), (chest[2], (-0.2, 0.2))):
        for edge in edges:
            values, slopes = [], []
            for over in (-1e-9, 0.0, 1e-9):
                d = jnp.zeros(SKELETON.num_dofs).at[slot].set(edge * (1 + over))
                pose = retract(SKELETON, rest_pose(SKELETON), d)
                values.append(float(jnp.abs(residual_of(energy, BODY, pose)).max()))
                slopes.append(np.abs(slope_of(energy, BODY, pose)).max())
            assert values[0] == 0.0
            assert values[1] < 1e-15
            assert 0.0 < values[2] < 1e-9
            assert slopes[0] == 0.0
            # the kink: anything between the slopes on its two sides
            assert 0.0 <= slopes[1] <= slopes[2] * (1 + 1e-6)
            assert slopes[2] > 0.1


def test_a_closed_cone_is_smooth_at_rest():
    """A cone of no angle is touched at rest, where the turned axis is at its top."""
    cones = {"chest": Cone((1, 0, 0), 0.0, (0, 1, 0), 0.0)}
    energy = JointLimits(make_joint_ranges(SKELETON, None, cones))
    rest = rest_pose(SKELETON)
    np.testing.assert_allclose(residual_of(energy, BODY, rest), 0.0, atol=1e-15)
    np.testing.assert_allclose(slope_of(energy, BODY, rest), 0.0, atol=1e-15)


def test_what_has_no_weight_is_not_there(rng):
    chosen, points, _, weights = some_pairs(rng)
    pose = random_pose(SKELETON, rng)
    energy = PointToPoint(chosen, points, weights)
    far = eqx.tree_at(lambda e: e.points, energy, points.at[:3].set(1e6))
    np.testing.assert_array_equal(residual_of(energy, BODY, pose), residual_of(far, BODY, pose))
    for term in (far, 0.0 * far):
        for leaf in jax.tree.leaves(sensitivity(term, BODY, pose)):
            assert np.isfinite(leaf).all()
    assert not np.any(sensitivity(far, BODY, pose).points[:3])
    assert not np.any(residual_of(0.0 * far, BODY, pose))


def test_the_gradient_to_points_and_weights_is_the_textbook_one(rng):
    """`E = sum w |x - y|^2`: `-2 w (x - y)` to the points, `|x - y|^2` to positive weights."""
    chosen, points, _, weights = some_pairs(rng)
    pose = random_pose(SKELETON, rng)
    apart = np.asarray(pose_body(BODY, pose).vertices[chosen] - points)
    gradient = sensitivity(PointToPoint(chosen, points, weights), BODY, pose)
    np.testing.assert_allclose(gradient.points, -2 * np.asarray(weights)[:, None] * apart, atol=1e-13)
    np.testing.assert_allclose(gradient.weights, np.where(weights > 0, np.sum(apart**2, 1), 0.0), atol=1e-13)


def test_energies_add_up_and_weights_multiply(rng):
    chosen, points, normals, weights = some_pairs(rng)
    pose = random_pose(SKELETON, rng)
    one, two = PointToPoint(chosen, points, weights), PointToPlane(chosen, points, normals, weights)
    alone = [float(value_of(energy, BODY, pose)) for energy in (one, two)]
    assert float(value_of(one + 3.0 * two, BODY, pose)) == pytest.approx(alone[0] + 3 * alone[1], rel=1e-13)
    named = energies(one + 3.0 * two + one, pose_body(BODY, pose))
    assert set(named) == {"PointToPoint", "PointToPlane"}
    assert float(named["PointToPoint"]) == pytest.approx(2 * alone[0], rel=1e-13)
    assert float(named["PointToPlane"]) == pytest.approx(3 * alone[1], rel=1e-13)


def test_distances_by_hand(rng):
    chosen, points, normals, weights = some_pairs(rng)
    pose = random_pose(SKELETON, rng)
    apart = np.asarray(pose_body(BODY, pose).vertices[chosen] - points)
    to_point = np.sum(np.asarray(weights) * np.sum(apart**2, 1))
    to_plane = np.sum(np.asarray(weights) * np.sum(apart * np.asarray(normals), 1) ** 2)
    assert float(value_of(PointToPoint(chosen, points, weights), BODY, pose)) == pytest.approx(
        to_point, rel=1e-12
    )
    assert float(value_of(PointToPlane(chosen, points, normals, weights), BODY, pose)) == pytest.approx(
        to_plane, rel=1e-12
    )


def test_sufficient_statistics_are_the_full_sum(rng):
    """Also for bones with no pair, with one, and with all their points on a line."""
    count = 60
    bones = np.concatenate([np.full(40, 2), np.full(1, 4), np.full(19, 7)])
    rest = rng.normal(size=(count, 3))
    rest[41:] = [1.0, 2.0, 3.0] + np.outer(rng.normal(size=19), [0.3, 0.1, -0.2])
    points, weights = rng.normal(size=(count, 3)) + 2.0, rng.uniform(0.0, 1.0, count)
    weights[5] = 0.0
    data = tuple(jnp.asarray(x) for x in (bones, rest, points, weights))
    reduced = rigid_moments(*data, SKELETON.num_joints)
    full = BoneLandmarks(*data)
    for size in (0.0, 0.5, 1.0):
        pose = random_pose(SKELETON, rng, size)
        expected = float(value_of(full, BODY, pose))
        assert float(value_of(reduced, BODY, pose)) == pytest.approx(expected, rel=1e-11)
        gradients = [2 * slope_of(e, BODY, pose).T @ residual_of(e, BODY, pose) for e in (full, reduced)]
        np.testing.assert_allclose(*gradients, atol=1e-9 * expected)
