"""Closed-form derivatives against autodiff, finite differences and the paper's operators."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import CORRECTED, SKINS, awkward_poses, chain_body, check_energy, random_pose
from jaxtyping import Array, Int

from jaxcap.body.body import Posed, pose_body
from jaxcap.body.geometric_jacobian import (
    concatenate_jacobians,
    joint_jacobian,
    pose_jacobian,
    select_parameters,
)
from jaxcap.body.kinematics import forward_kinematics
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.energy import AbstractEnergy
from jaxcap.fit.linearise import point_jacobian, vertex_jacobian
from jaxcap.geometry import rotation
from tests.kineben import ball_operator, cone_gradient, revolute_operator, translate_operator

BODIES = {skin: chain_body(skin) for skin in SKINS + CORRECTED}
#: some vertices, one of them twice, in no order
CHOSEN = jnp.array([40, 3, 17, 3, 25, 31, 0, 12, 44])

posed_of = eqx.filter_jit(pose_body)
whole_jacobian = eqx.filter_jit(vertex_jacobian)


@eqx.filter_jit
def directional_jacobian(posed, directions):
    """Rows of the chosen vertices along directions `(C, R, 3)`."""
    return point_jacobian(posed, CHOSEN[:, None], directions[:, None])


def chosen_jacobian(posed):
    """The derivative of the chosen vertices, `(C, 3, D)`."""
    axes = jnp.eye(3, dtype=posed.vertices.dtype)
    return directional_jacobian(posed, jnp.broadcast_to(axes, (len(CHOSEN), 3, 3)))


class Places(AbstractEnergy):
    """The posed vertices themselves."""

    vertices: Int[Array, "C"]

    def residual(self, posed: Posed):
        return posed.vertices[self.vertices].reshape(-1)


@pytest.fixture(params=BODIES)
def body(request):
    return BODIES[request.param]


def test_closed_form_against_autodiff_and_central_differences(body, rng):
    analytic = lambda posed: chosen_jacobian(posed).reshape(3 * len(CHOSEN), -1)  # noqa: E731
    check_energy(Places(CHOSEN), body, [random_pose(body.skeleton, rng, 1.0, scale=1.3)], analytic)


def test_projected_rows_are_the_jacobian_along_directions(body, rng):
    directions = jnp.asarray(rng.normal(size=(len(CHOSEN), 3)))
    for pose in awkward_poses(body.skeleton):
        posed = posed_of(body, pose)
        expected = jnp.einsum("ca,cad->cd", directions, whole_jacobian(posed)[CHOSEN])
        rows = directional_jacobian(posed, directions[:, None])[:, 0]
        np.testing.assert_allclose(rows, expected, atol=1e-14)


def moved(body, pose, directions, d, e):
    """Vertices along directions, after a tangent `d` of the pose and one `e` of all joints."""
    e = e.reshape(-1, 6)
    turned = rotation.multiply(body.skeleton.orientations, rotation.exp(e[:, 3:]))
    skeleton = eqx.tree_at(
        lambda s: (s.centres, s.orientations), body.skeleton, (body.skeleton.centres + e[:, :3], turned)
    )
    pose = retract(skeleton, pose, d)
    vertices = body.skin.deform(body.vertices, skeleton, pose, forward_kinematics(skeleton, pose))
    return jnp.einsum("vra,va->vr", directions, vertices)


@eqx.filter_jit
def both_rates(body, pose, directions):
    """The skin's own Jacobian by pose and joints, and forward differentiation."""
    skeleton, transforms = body.skeleton, forward_kinematics(body.skeleton, pose)
    rates = concatenate_jacobians(
        pose_jacobian(skeleton, pose, transforms), joint_jacobian(skeleton, pose, transforms)
    )
    own = body.skin.jacobian(body.vertices, directions, skeleton, pose, transforms, rates)
    still = jnp.zeros(skeleton.num_dofs), jnp.zeros(6 * skeleton.num_joints)
    some = select_parameters(rates, np.array([30, 2]))
    fewer = body.skin.jacobian(body.vertices, directions, skeleton, pose, transforms, some)
    exact = jax.jacfwd(lambda de: moved(body, pose, directions, *de))(still)
    return own, jnp.concatenate(exact, -1), fewer


@pytest.mark.parametrize("rows", [1, 3])
def test_rates_of_poses_and_joints_against_autodiff(body, rng, rows):
    directions = jnp.asarray(rng.normal(size=(len(body.vertices), rows, 3)))
    for pose in [*awkward_poses(body.skeleton), random_pose(body.skeleton, rng, 1.0, scale=1.3)]:
        own, exact, fewer = both_rates(body, pose, directions)
        assert np.abs(exact).max() > 1.0
        np.testing.assert_allclose(own, exact, rtol=0, atol=1e-12)
        np.testing.assert_allclose(fewer, own[:, :, np.array([30, 2])], atol=1e-15)


def test_papers_operators_are_the_twists(rng):
    """Kineben's 4 x 4 matrices (eqs. 8, 10, 13), applied to a rigid body's posed points."""
    body = BODIES["rigid"]
    skeleton = body.skeleton
    posed = posed_of(body, random_pose(skeleton, rng, 1.0))
    layout = dof_layout(skeleton)
    rotations, joints = posed.transforms.rotations, posed.joints
    columns = chosen_jacobian(posed)
    points = jnp.concatenate([posed.vertices[CHOSEN], jnp.ones((len(CHOSEN), 1))], 1)
    seen = set()
    for number, joint in enumerate(layout.joints):
        kind, parent = skeleton.kinds[joint], skeleton.parents[joint]
        above = rotations[parent] if parent >= 0 else jnp.eye(3)
        place = layout.rotations[joint].tolist()
        if number in layout.translations[joint]:
            operator = translate_operator(above[:, layout.translations[joint].tolist().index(number)])
        elif kind == "revolute":
            operator = revolute_operator(above @ skeleton.axes[joint, 0], joints[joint])
        elif kind in ("ball", "free"):
            operator = ball_operator(rotations[joint], joints[joint], place.index(number))
        else:
            continue
        seen.add(kind)
        moves = skeleton.descendants[joint][np.asarray(body.skin.bones[CHOSEN])]
        expected = np.where(moves[:, None], (points @ operator.T)[:, :3], 0.0)
        np.testing.assert_allclose(columns[:, :, number], expected, atol=1e-14)
    assert seen == {"free", "ball", "translate", "revolute"}


def test_ball_operator_is_the_papers_skew_form(rng):
    """Eqs. 12 and 41: the three columns together are `-[x - (R q + t)]x R`."""
    turn = rotation.to_matrix(rotation.exp(jnp.asarray(rng.normal(size=3))))
    centre, x = jnp.asarray(rng.normal(size=3)), jnp.asarray(rng.normal(size=3))
    columns = [(ball_operator(turn, centre, i) @ jnp.append(x, 1.0))[:3] for i in range(3)]
    np.testing.assert_allclose(np.stack(columns, 1), -rotation.skew(x - centre) @ turn, atol=1e-14)


def test_the_cone_gradient_has_the_papers_sign(rng):
    """Eq. 16 is `+ x_B x R^T x_B`, by central differences of `x_B . R exp(d) x_B`."""
    for angle in (0.0, 0.4, 2.0, np.pi - 1e-3):
        axis, turn_axis = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        axis, q = jnp.asarray(axis), rotation.exp(angle * jnp.asarray(turn_axis))
        cosine = lambda d, axis=axis, q=q: axis @ rotation.rotate(rotation.multiply(q, rotation.exp(d)), axis)  # noqa: E731
        numeric = np.array([(cosine(e) - cosine(-e)) / 2e-6 for e in 1e-6 * jnp.eye(3)])
        gradient = cone_gradient(axis, rotation.to_matrix(q))
        np.testing.assert_allclose(gradient, numeric, atol=1e-9)
        if 0.1 < angle < 3.0:
            assert np.abs(gradient).max() > 1e-2  # so that the other sign would not do


def test_the_jacobian_predicts_a_small_step(body, rng):
    """The error of the first order falls with the square of the step."""
    pose = random_pose(body.skeleton, rng, 0.8)
    posed = posed_of(body, pose)
    slope = chosen_jacobian(posed)
    d = jnp.asarray(rng.normal(size=body.skeleton.num_dofs))
    errors = []
    for size in (1e-2, 1e-3):
        moved = posed_of(body, retract(body.skeleton, pose, size * d)).vertices[CHOSEN]
        errors.append(float(jnp.abs(moved - posed.vertices[CHOSEN] - size * slope @ d).max()))
    assert errors[1] < 0.02 * errors[0]


def test_single_precision_keeps_its_digits(body, rng):
    """Within 2e-6 of float64, for a body of a metre."""
    pose = random_pose(body.skeleton, rng, 0.8)
    low = jax.tree.map(lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, (body, pose))
    posed = posed_of(*low)
    jacobian = chosen_jacobian(posed)
    assert jacobian.dtype == jnp.float32
    np.testing.assert_allclose(jacobian, chosen_jacobian(posed_of(body, pose)), atol=2e-6)
