"""A person's anatomy as the start of learning, and what meshes show of its joints."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from helpers import chain_body, random_pose
from scipy.spatial.transform import Rotation

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.anatomy.choose_skeleton import choose_skeleton
from jaxcap.learn.anatomy.find_person import (
    GOOD_PART_ERROR,
    MAX_FAR_SHARE,
    NoPerson,
    far_share,
    find_person,
    joint_extent,
    likeliest_meshes,
    part_error,
    up_axis,
)
from jaxcap.learn.anatomy.joint_evidence import describe_joints, far_joints, joint_evidence
from jaxcap.learn.anatomy.rest_of_template import rest_as_template
from jaxcap.learn.anatomy.small_joints import free_small_joints
from jaxcap.learn.objective import objective
from jaxcap.learn.people.rest_alignment import change_rest_pose
from jaxcap.learn.skeleton.check_skeleton import check_skeleton, winding_numbers
from jaxcap.learn.skeleton.given_centres import GivenCentres, carry_given
from jaxcap.learn.skeleton.joints import improve_joints, make_curvature
from jaxcap.observe.meshes import MeshSequence
from jaxcap.rigging.template import load_template

TUBE = trimesh.creation.capsule(height=1.0, radius=0.12, count=[24, 12])


def test_meshes_like_the_human_at_rest_are_tried_first(rng):
    body = jc.human(resolution="low", sex="female")
    rest, faces = np.array(body.vertices, float), np.array(body.faces)
    turn = Rotation.from_rotvec([0, 1.1, 0])
    # a turn about the vertical does not count; a bend and arms that are raised do
    share = np.clip(2 * rest[:, 1:2], 0, 1)
    bends = [Rotation.from_rotvec(angle * share * [[1.0, 0, 0]]).apply(rest) for angle in (1.4, 0.5)]
    shapes = np.stack([bends[0], turn.apply(1.2 * rest), bends[1]])
    np.testing.assert_array_equal(likeliest_meshes(shapes, faces), [1, 2, 0])
    raised = shapes[:, :, [0, 2, 1]] * [1, -1, 1]
    np.testing.assert_array_equal(likeliest_meshes(raised, faces, "z"), [1, 2, 0])
    assert [up_axis(shapes[:2, :, list(order)]) for order in ((1, 0, 2), (0, 1, 2), (0, 2, 1))] == [
        "x",
        "y",
        "z",
    ]


def test_a_skeleton_that_does_not_follow_the_surface_is_refused():
    body = jc.human(resolution="low")
    poses = jc.body.sample_poses(body.skeleton, count=4)
    shapes = np.asarray(jax.lax.map(lambda pose: jc.pose_body(body, pose).vertices, poses), float)
    assert far_share(body) == 0.0
    assert part_error(body, shapes) < GOOD_PART_ERROR
    # a forearm that is folded into the trunk: no vertex moves with it, or its joints are elsewhere
    arm = np.flatnonzero(body.skeleton.descendants[body.skeleton.index("LeftForeArm")])
    weights = np.array(body.skin.bone_weights(31))
    weights[:, body.skeleton.index("Spine1")] += weights[:, arm].sum(1)
    weights[:, arm] = 0.0
    skin = jc.body.RigidSkin(jnp.asarray(weights.argmax(1)))
    stiff = jc.Body(body.skeleton, skin, body.vertices, body.faces)
    assert part_error(stiff, shapes) > 2 * part_error(body, shapes)
    inside = body.skeleton.centres.at[arm].set(body.skeleton.centres[body.skeleton.index("Spine1")])
    folded = eqx.tree_at(lambda b: b.skeleton.centres, body, inside)
    assert far_share(folded) > 5 * MAX_FAR_SHARE


def test_a_person_who_bends_over_is_as_large_as_upright():
    body = jc.human(resolution="low")
    rest = jc.rest_pose(body.skeleton)
    bend = jnp.zeros((31, 3)).at[body.skeleton.index("LowerBack")].set(jnp.array([1.6, 0.0, 0.0]))
    posed = jc.pose_body(body, eqx.tree_at(lambda p: p.rotations, rest, rotation.exp(bend)))
    bent = eqx.tree_at(lambda s: s.centres, body.skeleton, posed.joints)
    assert np.ptp(np.asarray(posed.joints), axis=0).max() < 0.9 * joint_extent(bent)
    upright = np.ptp(np.asarray(body.skeleton.centres), axis=0).max()
    np.testing.assert_allclose(joint_extent(bent), upright, rtol=0.05)


def test_meshes_without_a_person_are_searched_freely():
    meshes = MeshSequence(np.stack([np.array(TUBE.vertices)[:200]] * 2), np.array(TUBE.faces)[:10])
    assert isinstance(find_person(meshes), NoPerson)
    placed, sentence = choose_skeleton(meshes, "automatic")
    assert placed is None and "200 vertices are too few" in sentence
    with pytest.raises(InputError, match="cannot be placed: 200 vertices are too few"):
        choose_skeleton(meshes, "human")


def test_a_joint_on_the_middle_stays_in_its_plane(rng):
    body = chain_body()
    poses = jc.stack_poses([random_pose(body.skeleton, rng, 0.5) for _ in range(8)]).poses
    targets = posed_vertices(body, poses)
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 10.0)
    count, joint = body.skeleton.num_joints, 2
    off = eqx.tree_at(
        lambda b: b.skeleton.centres,
        body,
        body.skeleton.centres.at[joint].add(jnp.array([0.01, -0.01, 0.01])),
    )
    normal = np.array([0.6, 0.0, 0.8])
    given = GivenCentres(off.skeleton.centres, normals=jnp.zeros((count, 3)).at[joint].set(normal))
    value, damping, none = float(objective(off, poses, targets, metric)), 1e-3, np.zeros((0, 2), int)
    for _ in range(4):
        off, poses, after, damping = improve_joints(
            off, poses, targets, metric, make_curvature(metric), none, damping, value, given_centres=given
        )
        assert after < value
        value = after
    step = np.asarray(off.skeleton.centres - given.centres)[joint]
    np.testing.assert_allclose(step @ normal, 0.0, atol=1e-12)
    # within the plane the data move it, towards the truth
    towards = np.array([-0.01, 0.01, -0.01])
    towards -= (towards @ normal) * normal
    assert step @ towards > 0.5 * towards @ towards


def test_evidence_is_what_the_meshes_show():
    names = ["root", "spine", "LeftLeg", "LeftFoot", "RightLeg", "RightFoot"]
    centres = np.array([[0, 0, 0], [0, 0.1, 0], [0.1, 0, 0], [0.1, -0.3, 0.4], [-0.1, 0, 0], [-0.1, 0, 0.5]])
    skeleton = jc.make_skeleton(names, [-1, 0, 0, 2, 0, 4], ["free"] + ["ball"] * 5, centres)
    shares = np.linspace(-1, 1, 9)
    rotations = np.tile([1.0, 0, 0, 0], (9, 6, 1))
    for joint, degrees in ((2, 40), (3, 50), (4, 2)):
        vectors = np.radians(degrees) * shares[:, None] * [1.0, 0, 0]
        rotations[:, joint] = Rotation.from_rotvec(vectors).as_quat(scalar_first=True)
    poses = jc.Pose(jnp.zeros((9, 6, 3)), jnp.asarray(rotations), jnp.ones(9))
    given = GivenCentres(jnp.asarray(centres + [0.0, 0.003, 0.004]))
    found = joint_evidence(skeleton, jc.Motion(poses, 30.0), np.array([[2, 4], [3, 5]]), given)
    np.testing.assert_allclose(found.rotations, [0, 40, 50, 2, 0], atol=1e-6)
    np.testing.assert_allclose(found.lengths, [0.1, 0.1, 0.5, 0.1, 0.5])
    np.testing.assert_array_equal(found.partners, [-1, 3, 4, 1, 2])
    np.testing.assert_allclose(found.shifts, 0.005)
    np.testing.assert_array_equal(found.determined, [False, True, True, False, False])
    assert found.largest_length_difference == 0.0
    one = found._replace(lengths=np.array([0.0, 0.1, 0.5, 0.0, 0.4]), partners=np.array([3, -1, 4, 0, 2]))
    np.testing.assert_allclose(one.largest_length_difference, 0.2)
    assert far_joints(found) == []
    (sentence,) = far_joints(found._replace(shifts=np.array([0, 0.064, 0.03, 0, 0])))
    assert "LeftLeg (64 mm);" in sentence
    table = describe_joints(found, True)
    assert table[2].split() == [
        "LeftLeg",
        "/",
        "RightLeg",
        "100",
        "/",
        "100",
        "40°",
        "/",
        "2°",
        "meshes",
        "(5",
        "mm)",
        "/",
        "anatomy",
    ]
    assert len(table) == 4


def test_small_joints_are_free_where_meshes_show_it(rng):
    names = ["forearm", "hand", "finger"]
    skeleton = jc.make_skeleton(
        names, [-1, 0, 1], ["free", "ball", "fixed"], [[0, 0, 0], [0.25, 0, 0], [0.33, 0, 0]]
    )
    rest = rng.uniform([0, -0.02, -0.02], [0.4, 0.02, 0.02], (600, 3))
    labels = np.searchsorted([0.25, 0.33], rest[:, 0])
    turns = Rotation.from_rotvec(np.linspace(-0.8, 0.8, 5)[:, None] * [0, 0, 1.0])
    finger = np.stack([turn.apply(rest - [0.33, 0, 0]) + [0.33, 0, 0] for turn in turns])
    noise = 0.0005 * rng.normal(size=finger.shape)
    moved = np.where((labels == 2)[:, None], finger, rest) + noise
    assert free_small_joints(skeleton, rest, moved, labels).kinds == ("free", "ball", "ball")
    still = np.where((labels >= 1)[:, None], finger, rest) + noise
    assert free_small_joints(skeleton, rest, still, labels).kinds == ("free", "ball", "fixed")


def test_joints_outside_and_joints_in_one_place_are_named(rng):
    vertices, faces = np.array(TUBE.vertices), np.array(TUBE.faces)
    points = rng.uniform(-0.7, 0.7, (40, 3)) * [0.3, 0.3, 1.0]
    inside = winding_numbers(points, vertices, faces) > 0.5
    np.testing.assert_array_equal(inside, TUBE.contains(points))
    skin = jc.body.RigidSkin(jnp.zeros(len(vertices), jnp.int32))

    def messages(centres):
        names = ["root", "low", "high"]
        skeleton = jc.make_skeleton(names, [-1, 0, 1], ["free", "ball", "ball"], centres)
        return check_skeleton(jc.Body(skeleton, skin, jnp.asarray(vertices), jnp.asarray(faces)))

    assert messages([[0, 0, -0.4], [0, 0, 0.0], [0, 0, 0.3]]) == []
    assert messages([[0, 0, -0.4], [0, 0, 0.0], [0.2, 0, 0.3]]) == ["high is outside of the body."]
    (near,) = messages([[0, 0, -0.4], [0, 0, 0.0], [0, 0, 0.1]])
    assert "low and high (100 mm)" in near


@pytest.mark.slow
def test_a_made_person_gets_the_joints_of_a_person(rng):
    """Ten meshes of a woman, her vertices in random order: her hips and knees by name, left as long as right."""
    body = jc.human(sex="female", resolution="low", joints="tracking")
    order = rng.permutation(len(body.vertices))
    faces = jnp.asarray(np.argsort(order)[np.asarray(body.faces)], jnp.int32)
    body = jc.Body(body.skeleton, body.skin.take(order), body.vertices[order], faces)
    poses = jc.body.sample_poses(body.skeleton, count=10)
    posed = jax.lax.map(lambda pose: jc.pose_body(body, pose), poses)
    learned = jc.learn_body(MeshSequence(posed.vertices, body.faces), rounds=4)
    names, found = learned.body.skeleton.names, learned.body
    joints = jax.lax.map(lambda pose: jc.pose_body(found, pose).joints, learned.motion.poses)
    for name in ("LeftUpLeg", "RightUpLeg", "LeftLeg", "RightLeg", "LeftArm", "RightArm"):
        assert names.count(name) == 1
        away = posed.joints[:, body.skeleton.index(name)] - joints[:, names.index(name)]
        assert float(jnp.linalg.norm(away, axis=1).mean()) < 0.025, name
    evidence = joint_evidence(found.skeleton, learned.motion, learned.left_right_pairs, learned.given)
    assert evidence.largest_length_difference < 0.005
    middle = np.asarray(learned.given.normals)
    away = np.sum(np.asarray(found.skeleton.centres - learned.given.centres) * middle, 1)
    np.testing.assert_allclose(away, 0.0, atol=1e-5)


def test_given_centres_move_with_the_surface(rng):
    body = chain_body()
    given = GivenCentres(body.skeleton.centres + 0.01)
    turn, shift = Rotation.from_rotvec([0.2, -0.1, 0.4]), np.array([0.1, -0.2, 0.05])
    rest = jnp.asarray(turn.apply(np.array(body.vertices)) + shift)
    moved = carry_given(given, body, rest)
    np.testing.assert_allclose(moved.centres, turn.apply(np.array(given.centres)) + shift, atol=1e-6)
    # on the middle, all move sideways by the same distance
    normals = jnp.zeros_like(given.centres).at[1:].set(jnp.array([0.0, 0.0, 1.0]))
    uneven = rest + jnp.asarray(0.02 * rng.normal(size=rest.shape))
    moved = carry_given(given._replace(normals=normals), body, uneven)
    away = np.asarray(moved.centres - given.centres)[1:, 2]
    np.testing.assert_allclose(away, away[0], atol=1e-6)
    fixed = given._replace(is_fixed=True)
    assert carry_given(fixed, body, rest) is fixed
    assert carry_given(None, body, rest) is None


def test_a_placed_person_rests_as_the_human(rng):
    template = load_template().body
    skeleton = template.skeleton
    rotations = rotation.exp(jnp.asarray(0.4 * rng.normal(size=(5, 31, 3))))
    poses = jc.stack_poses([jc.rest_pose(skeleton)] * 5).poses
    poses = eqx.tree_at(lambda p: p.rotations, poses, rotations)
    targets = posed_vertices(template, poses)
    # the skeleton as it is placed in the first mesh
    first = jc.pose_body(template, jax.tree.map(lambda leaf: leaf[0], poses))
    turned = rotation.from_matrix(first.transforms.rotations)
    frames = (
        rotation.multiply(turned, skeleton.orientations),
        jnp.einsum("jab,jkb->jka", first.transforms.rotations, skeleton.axes),
    )
    placed = eqx.tree_at(lambda s: (s.centres, s.orientations, s.axes), skeleton, (first.joints, *frames))
    body = jc.Body(placed, template.skin, targets[0], template.faces)
    above = jnp.where(
        np.arange(31)[:, None] == 0, rotation.identity(), turned[np.maximum(skeleton.parents, 0)]
    )
    to_rest = rotation.multiply(above, rotation.conjugate(turned))
    back = change_rest_pose(
        skeleton, poses, eqx.tree_at(lambda p: p.rotations, jc.rest_pose(skeleton), to_rest)
    )
    given = GivenCentres(placed.centres + 0.01)
    found, own, moved = rest_as_template(body, back, targets, given)
    np.testing.assert_allclose(posed_vertices(found, own), targets, atol=2e-4)
    # the human at rest, but for the direction of the trunk
    root = Rotation.from_quat(np.array(turned)[0, [1, 2, 3, 0]])
    for some, rest in ((found.skeleton.centres, skeleton.centres), (found.vertices, template.vertices)):
        away = root.inv().apply(np.array(some - found.skeleton.centres[0]))
        np.testing.assert_allclose(away, np.asarray(rest - skeleton.centres[0]), atol=1e-3)
    lateral = root.inv().apply(np.array(found.skeleton.axes)[:, 0])
    np.testing.assert_allclose(lateral, np.asarray(skeleton.axes)[:, 0], atol=1e-5)
    gaps = np.linalg.norm(np.asarray(moved.centres - found.skeleton.centres), axis=1)
    np.testing.assert_allclose(gaps, 0.01 * np.sqrt(3), rtol=1e-3)
