"""Skins: rigid facts, independence of the order of bones, and a slow sum."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import CORRECTED, SKINS, awkward_poses, chain_body, random_pose

from jaxcap.body import body as bodies
from jaxcap.body.kinematics import Transforms
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.skeleton import make_skeleton
from jaxcap.body.skin import CorrectedSkin, DualQuaternionSkin, LinearSkin, SwingTwistSkin

BODIES = {skin: chain_body(skin) for skin in SKINS + CORRECTED}
pose_body = eqx.filter_jit(bodies.pose_body)


@pytest.fixture(params=BODIES)
def body(request) -> bodies.Body:
    return BODIES[request.param]


def test_rest_gives_rest(body):
    posed = pose_body(body, rest_pose(body.skeleton))
    np.testing.assert_allclose(posed.vertices, body.vertices, atol=1e-15)
    np.testing.assert_allclose(posed.joints, body.skeleton.centres, atol=1e-15)


def test_influence_is_a_share_of_one(body):
    shares = np.asarray(body.skin.bone_weights(body.skeleton.num_joints))
    assert shares.shape == (len(body.vertices), body.skeleton.num_joints)
    assert (shares >= 0).all()
    np.testing.assert_allclose(shares.sum(1), 1.0, atol=1e-14)
    np.testing.assert_array_equal(body.skin.dominant_bones(), shares.argmax(1))


@pytest.mark.parametrize("skin", ["rigid", "linear"])
def test_vertices_are_the_weighted_sum_of_their_bones(skin, rng):
    body = BODIES[skin]
    shares = np.asarray(body.skin.bone_weights(body.skeleton.num_joints))
    for pose in [*awkward_poses(body.skeleton), random_pose(body.skeleton, rng, 1.0, scale=1.2)]:
        posed = pose_body(body, pose)
        r, t = np.asarray(posed.transforms.rotations), np.asarray(posed.transforms.translations)
        expected = np.zeros((len(body.vertices), 3))
        for v, vertex in enumerate(np.asarray(body.vertices)):
            for j in range(body.skeleton.num_joints):
                expected[v] += shares[v, j] * (r[j] @ vertex + t[j])
        np.testing.assert_allclose(posed.vertices, expected, atol=1e-13)


def test_one_motion_of_all_bones_moves_the_surface_by_it(body, rng):
    """Equal transforms in, the same out; and turning the root by itself turns vertices and normals."""
    count = body.skeleton.num_joints
    posed = pose_body(body, random_pose(body.skeleton, rng, 1.0))
    r, t = posed.transforms.rotations[3], posed.transforms.translations[3]
    same = Transforms(jnp.tile(r, (count, 1, 1)), jnp.tile(t, (count, 1)))
    moved = body.skin.deform(body.vertices, body.skeleton, rest_pose(body.skeleton), same)
    np.testing.assert_allclose(moved, body.vertices @ r.T + t, atol=1e-13)
    d = jnp.zeros(body.skeleton.num_dofs).at[:6].set(jnp.asarray(rng.normal(size=6)))
    rest, turned = (
        pose_body(body, rest_pose(body.skeleton)),
        pose_body(body, retract(body.skeleton, rest_pose(body.skeleton), d)),
    )
    r, t = turned.transforms.rotations[0], turned.transforms.translations[0]
    np.testing.assert_allclose(turned.vertices, rest.vertices @ r.T + t, atol=1e-13)
    np.testing.assert_allclose(turned.normals, rest.normals @ r.T, atol=1e-12)


@pytest.mark.parametrize("scheme", [LinearSkin, DualQuaternionSkin, "of the bone", "of its parent"])
def test_whole_weights_are_rigid(scheme, rng):
    """Each scheme with weights in {0, 1}; swing-twist says "with this bone" in two ways, which are
    one also where the joint shifts as well as turns."""
    body = BODIES["rigid"]
    bones, parents = body.skin.bones, jnp.array(body.skeleton.parents)
    whole = body.skin.bone_weights(body.skeleton.num_joints)
    if scheme == "of the bone":
        skin = SwingTwistSkin(bones, 0 * whole, 0 * whole)
    elif scheme == "of its parent":
        below = jnp.where((parents[bones] >= 0)[:, None], whole, 0.0)
        skin = SwingTwistSkin(jnp.maximum(parents[bones], 0), below, below)
    else:
        skin = scheme(whole)
    for pose in [*awkward_poses(body.skeleton), random_pose(body.skeleton, rng, 1.0, scale=1.3)]:
        moved = pose_body(bodies.Body(body.skeleton, skin, body.vertices, body.faces), pose)
        np.testing.assert_allclose(moved.vertices, pose_body(body, pose).vertices, atol=1e-14)


def test_a_scaled_body_is_the_same_one_in_another_size(body, rng):
    larger = bodies.scale_body(body, jnp.asarray(1.3))
    for pose in (rest_pose(body.skeleton), random_pose(body.skeleton, rng, 0.8)):
        grown = Pose(1.3 * pose.translations, pose.rotations, pose.scale)
        np.testing.assert_allclose(
            pose_body(larger, grown).vertices, 1.3 * pose_body(body, pose).vertices, atol=1e-12
        )


def test_the_order_of_bones_does_not_matter(body, rng):
    """Joints given in another order, weights and pose with them, put vertices at the same place."""
    if isinstance(body.skin, CorrectedSkin):
        pytest.skip("its features are in the order of the joints")
    skeleton, pose = body.skeleton, random_pose(body.skeleton, rng, 1.0)
    order = rng.permutation(skeleton.num_joints)
    place = np.argsort(order)
    other = make_skeleton(
        [skeleton.names[i] for i in order],
        [-1 if skeleton.parents[i] < 0 else int(place[skeleton.parents[i]]) for i in order],
        [skeleton.kinds[i] for i in order],
        skeleton.centres[order],
        skeleton.orientations[order],
        skeleton.axes[order],
    )
    back = np.array([skeleton.index(name) for name in other.names])
    assert (back != np.arange(len(back))).any()
    bones = jnp.asarray(np.argsort(back))
    skin = jax.tree.map(lambda x: bones[x] if x.ndim == 1 else x[:, back], body.skin)
    shuffled = bodies.Body(other, skin, body.vertices, body.faces)
    moved = pose_body(shuffled, Pose(pose.translations[back], pose.rotations[back], pose.scale))
    np.testing.assert_allclose(moved.vertices, pose_body(body, pose).vertices, atol=1e-13)


def test_posing_is_in_single_precision_what_it_is_in_double(body, rng):
    """Within 1e-6 m for a body of a metre."""
    pose = random_pose(body.skeleton, rng, 0.7)
    low, high = pose_body(single(body), single(pose)), pose_body(body, pose)
    assert low.vertices.dtype == jnp.float32
    np.testing.assert_allclose(low.vertices, high.vertices, atol=1e-6)
    np.testing.assert_allclose(low.normals, high.normals, atol=2e-5)


def test_two_poses_take_one_trace(body, rng):
    traces = 0

    @eqx.filter_jit
    def counted(body, pose):
        nonlocal traces
        traces += 1
        return bodies.pose_body(body, pose)

    for size in (0.1, 1.0):
        counted(body, random_pose(body.skeleton, rng, size))
    assert traces == 1


def test_height_is_the_longest_side(body):
    box = np.ptp(np.asarray(body.vertices), axis=0)
    assert float(bodies.body_height(body)) == pytest.approx(box.max())


def single(tree):
    """Every float of a tree in float32."""
    return jax.tree.map(lambda x: x.astype(jnp.float32) if eqx.is_inexact_array(x) else x, tree)
