"""Swing-twist skinning against a slow sum of its own, and where its derivatives are delicate."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import SKINS, awkward_poses, chain_body, half_turned_pose, random_pose
from scipy.spatial.transform import Rotation

from jaxcap.body import body as bodies
from jaxcap.body.pose import Pose, rest_pose
from jaxcap.body.skin import LinearSkin, SwingTwistSkin, swing_twist_from
from jaxcap.geometry import rotation

BODY = chain_body("swing_twist")
SKELETON = BODY.skeleton
pose_body = eqx.filter_jit(bodies.pose_body)


def slow_vertex(body, pose, transforms, v):
    """Adaptation, eqs. 3.13 to 3.18, by SciPy's rotations and screws, one joint at a time."""
    point, base = body.vertices[v], int(body.skin.bases[v])
    turns = []
    for j in range(SKELETON.num_joints):
        frame = Rotation.from_quat(body.skeleton.orientations[j], scalar_first=True)
        whole = Rotation.from_quat(pose.rotations[j], scalar_first=True)
        w, x, _, _ = (frame.inv() * whole * frame).as_quat(scalar_first=True)
        local = Rotation.from_quat([w, x, 0, 0], scalar_first=True) if w or x else Rotation.identity()
        twist = frame * local * frame.inv()
        turns.append((twist, whole * twist.inv(), body.skeleton.centres[j]))
    weights, duals = [1 - np.sum(body.skin.twist[v])], [(np.array([1.0, 0, 0, 0]), np.zeros(4))]
    for (twist, _, centre), weight in zip(turns, body.skin.twist[v], strict=True):
        real = twist.as_quat(scalar_first=True)
        shift = centre - twist.apply(centre)
        duals.append((real, 0.5 * np.array(hamilton([0.0, *shift], real))))
        weights.append(weight)
    leader = duals[int(np.argmax(weights))][0]
    signed = [w * (-1 if d[0] @ leader < 0 else 1) for w, d in zip(weights, duals, strict=True)]
    real = sum(w * d[0] for w, d in zip(signed, duals, strict=True))
    dual = sum(w * d[1] for w, d in zip(signed, duals, strict=True))
    length = np.linalg.norm(real)
    shift = 2 * np.array(hamilton(dual, real * [1, -1, -1, -1]))[1:] / length**2
    twisted = Rotation.from_quat(real, scalar_first=True).apply(point) + shift
    beside = (1 - np.sum(body.skin.swing[v])) * twisted
    for j, (_, swing, centre) in enumerate(turns):
        moved = swing.apply(twisted - centre) + centre + pose.translations[j]
        beside = beside + float(body.skin.swing[v, j]) * moved
    return transforms.rotations[base] @ beside + transforms.translations[base]


def hamilton(a, b):
    (aw, *av), (bw, *bv) = a, b
    return [aw * bw - np.dot(av, bv), *(aw * np.array(bv) + bw * np.array(av) + np.cross(av, bv))]


def test_a_slow_sum_of_its_own(rng):
    for pose in [*awkward_poses(SKELETON), random_pose(SKELETON, rng, 1.0, scale=1.3)]:
        posed = pose_body(BODY, pose)
        plain = jax.tree.map(np.array, (BODY, pose, posed.transforms))
        expected = [slow_vertex(*plain, v) for v in range(0, len(BODY.vertices), 2)]
        np.testing.assert_allclose(posed.vertices[::2], expected, atol=1e-12)


def test_from_linear_weights_one_joint_alone_swings_alike(rng):
    """A swing of one joint takes a vertex that blends the joint and its parent where LBS does."""
    hand, elbow = SKELETON.index("hand"), SKELETON.index("elbow")
    weights = np.zeros((len(BODY.vertices), SKELETON.num_joints))
    share = rng.uniform(size=len(weights))
    weights[:, elbow], weights[:, hand] = 1 - share, share
    linear = LinearSkin(jnp.asarray(weights))
    skin = swing_twist_from(linear, SKELETON)
    np.testing.assert_allclose(skin.bone_weights(SKELETON.num_joints), weights, atol=1e-15)
    frame = np.asarray(SKELETON.orientations[hand])
    across = Rotation.from_quat(frame, scalar_first=True).apply([0.0, 0.6, 0.8])
    pose = rest_pose(SKELETON)
    turned = rotation.about_axis(jnp.asarray(across), jnp.asarray(1.2))
    pose = Pose(pose.translations, pose.rotations.at[hand].set(turned), pose.scale)
    moved = [
        pose_body(bodies.Body(SKELETON, some, BODY.vertices, BODY.faces), pose).vertices
        for some in (skin, linear)
    ]
    np.testing.assert_allclose(*moved, atol=1e-13)
    assert float(jnp.abs(moved[0] - BODY.vertices).max()) > 0.05


def test_from_linear_weights_what_lies_beyond_goes_to_its_branch():
    names = [SKELETON.index(name) for name in ("chest", "slide", "elbow", "neck", "spine")]
    chest, slide, _, neck, _ = names
    row = np.zeros((1, SKELETON.num_joints))
    row[0, names] = [0.4, 0.2, 0.05, 0.25, 0.1]
    skin = swing_twist_from(LinearSkin(jnp.asarray(row)), SKELETON)
    assert int(skin.bases[0]) == chest
    expected = np.zeros(SKELETON.num_joints)
    expected[[slide, neck]] = 0.25, 0.25
    np.testing.assert_allclose(skin.swing[0], expected, atol=1e-15)
    np.testing.assert_allclose(skin.twist[0], expected, atol=1e-15)
    with pytest.raises(ValueError, match="for 2 bones and the skeleton has 9"):
        swing_twist_from(LinearSkin(jnp.ones((1, 2))), SKELETON)


def test_carried_weights_lie_between_those_of_the_corners():
    faces = BODY.faces
    at_corners = BODY.skin.transfer(faces, jnp.tile(jnp.array([1.0, 0, 0]), (len(faces), 1)), SKELETON)
    corner = BODY.skin.take(faces[:, 0])
    # the same map, perhaps said of another base
    for pose in awkward_poses(SKELETON)[1:3]:
        points = BODY.vertices[faces[:, 0]]
        moved = [
            pose_body(bodies.Body(SKELETON, some, points, faces[:0]), pose).vertices
            for some in (at_corners, corner)
        ]
        same_base = np.asarray(at_corners.bases == corner.bases)
        assert same_base.mean() > 0.5
        np.testing.assert_allclose(moved[0][same_base], moved[1][same_base], atol=1e-14)
    middle = BODY.skin.transfer(faces, jnp.full((len(faces), 3), 1 / 3), SKELETON)
    influence = np.asarray(middle.bone_weights(SKELETON.num_joints))
    np.testing.assert_allclose(influence.sum(1), 1.0, atol=1e-13)
    assert influence.min() > -1e-15


@eqx.filter_jit
def value_and_slopes(body, pose, probe):
    """A number made of posed vertices, its gradient to all floats, and to the pose's."""

    def value(both):
        body, pose = both
        # as a quaternion of any length, for which the paper's formulas hold no more than for unit ones
        unit = eqx.tree_at(lambda p: p.rotations, pose, rotation.normalise(pose.rotations))
        return jnp.sum(probe * bodies.pose_body(body, unit).vertices)

    return eqx.filter_value_and_grad(value)((body, pose))


def delicate_poses(skeleton) -> dict[str, Pose]:
    """Rest, half turns about twist axes, and swings by pi, where twists are not defined."""
    rest = rest_pose(skeleton)
    poses = {"rest": rest}
    for name, axis in (
        ("half twist", [1.0, 0, 0]),
        ("half swing", [0, 0.6, 0.8]),
        ("half turn", [0.6, 0, 0.8]),
    ):
        along = rotation.rotate(skeleton.orientations, jnp.tile(jnp.array(axis), (skeleton.num_joints, 1)))
        turned = jnp.concatenate([jnp.zeros_like(along[:, :1]), along], 1)
        poses[name] = Pose(rest.translations, turned, rest.scale)
    return poses


@pytest.mark.parametrize("skin", SKINS)
def test_gradients_are_finite_where_angles_are_zero_or_pi(skin, rng):
    body = chain_body(skin)
    probe = jnp.asarray(rng.normal(size=body.vertices.shape))
    for name, pose in delicate_poses(body.skeleton).items():
        value, slopes = value_and_slopes(body, pose, probe)
        assert np.isfinite(value), name
        for leaf in jax.tree.leaves(slopes):
            assert np.isfinite(leaf).all(), name


@pytest.mark.parametrize("skin", SKINS)
def test_gradients_to_weights_vertices_and_joints_against_central_differences(skin, rng):
    """Along random directions, at rest, at an ordinary pose and near half turns."""
    body = chain_body(skin)
    probe = jnp.asarray(rng.normal(size=body.vertices.shape))
    # at a half turn itself the shorter way round is undecided, and blends of dual quaternions jump
    near_half = half_turned_pose(body.skeleton, np.random.default_rng(0), short_of=0.05)
    for pose in (rest_pose(body.skeleton), awkward_poses(body.skeleton)[3], near_half):
        _, slopes = value_and_slopes(body, pose, probe)
        floats, rest = eqx.partition((body, pose), eqx.is_inexact_array)
        for place, leaf in enumerate(jax.tree.leaves(floats)):
            step = 1e-6 * rng.normal(size=leaf.shape)

            def at(sign, place=place, step=step, floats=floats, rest=rest):
                leaves, shape = jax.tree.flatten(floats)
                leaves[place] = leaves[place] + sign * step
                return float(
                    value_and_slopes(*eqx.combine(jax.tree.unflatten(shape, leaves), rest), probe)[0]
                )

            expected = (at(1.0) - at(-1.0)) / 2
            found = float(jnp.sum(jax.tree.leaves(slopes)[place] * step))
            assert found == pytest.approx(expected, abs=2e-11 + 1e-4 * abs(expected)), place


def test_a_weight_takes_a_vertex_from_its_base_to_the_child(rng):
    """No weight is the base's map and a whole one the child's; a half is neither."""
    chest, neck = SKELETON.index("chest"), SKELETON.index("neck")
    pose = random_pose(SKELETON, rng, 1.0)
    places = []
    for share in (0.0, 0.5, 1.0):
        row = jnp.zeros((1, SKELETON.num_joints)).at[0, neck].set(share)
        skin = SwingTwistSkin(jnp.array([chest]), row, row)
        places.append(pose_body(bodies.Body(SKELETON, skin, BODY.vertices[:1], BODY.faces[:0]), pose))
    for place, bone in ((places[0], chest), (places[2], neck)):
        r, t = place.transforms.rotations[bone], place.transforms.translations[bone]
        np.testing.assert_allclose(place.vertices[0], r @ BODY.vertices[0] + t, atol=1e-14)
    middle = np.asarray(places[1].vertices[0])
    assert min(np.abs(middle - np.asarray(places[i].vertices[0])).max() for i in (0, 2)) > 1e-3
