"""One body of several people: shared weights, one rest pose, and a shape space that is recovered."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import random_pose

import jaxcap as jc
from jaxcap.body.body import posed_vertices
from jaxcap.body.pose import Motion, stack_poses
from jaxcap.cli.learn.people_state import load_people_state, make_people_checkpoint
from jaxcap.errors import InputError
from jaxcap.geometry import rotation
from jaxcap.geometry.laplacian import energy, make_conformance
from jaxcap.io.archives.checkpoint import save_checkpoint
from jaxcap.learn.people.check_people import (
    check_people,
    find_bent_joints,
    find_far_joints,
    find_moving,
    find_people_by_size,
)
from jaxcap.learn.people.person import LENGTHS, Person, repeat_meshes, repeated_rows
from jaxcap.learn.people.rest_alignment import align_rest_poses, check_rest_alignment, rotate_at_rest
from jaxcap.learn.people.rounds import evaluate, improve_people, make_mesh_metric
from jaxcap.learn.people.shape_space import make_shape_space, person_body, refit_poses
from jaxcap.learn.skeleton.given_centres import GivenCentres
from jaxcap.learn.weights.improve_weights import PosedMeshes, improve_shared_weights, improve_weights
from jaxcap.learn.weights.rest_vertices import fit_rest_vertices
from jaxcap.observe.meshes import MeshSequence
from tests.learn.people.made_limb import RINGS, SIDES, limb, tube

MESHES = 4


def poses_of(body: jc.Body, rng, count: int = MESHES, size: float = 0.5) -> jc.Pose:
    return stack_poses([random_pose(body.skeleton, rng, size) for _ in range(count)]).poses


def given_of(body: jc.Body) -> GivenCentres:
    return GivenCentres(body.skeleton.centres)


@pytest.mark.parametrize("skin", ["start", "swing_twist"])
def test_frames_in_two_groups_give_the_weights_of_all(skin, rng):
    true, start = limb(), limb(skin=skin)
    poses = poses_of(true, rng, 8)
    targets = posed_vertices(true, poses)
    metric = make_conformance(np.asarray(true.faces), len(true.vertices), 10.0)
    whole = improve_weights(start, poses, targets, metric, sweeps=3)
    halves = [
        PosedMeshes(start, jax.tree.map(lambda leaf, r=rows: leaf[r], poses), targets[rows])
        for rows in (slice(0, 4), slice(4, 8))
    ]
    shared = improve_shared_weights(halves, metric, sweeps=3)
    np.testing.assert_allclose(shared.energies, whole.energies, rtol=1e-9)
    np.testing.assert_allclose(shared.body.skin.bone_weights(3), whole.body.skin.bone_weights(3), atol=1e-9)


def test_weights_of_people_of_different_shapes_are_found(rng):
    people, metric = [], make_conformance(tube()[1], RINGS * SIDES, 1.0)
    for length, radius in ((1.0, 0.06), (1.3, 0.05), (0.8, 0.09)):
        true = limb(length, radius)
        poses = poses_of(true, rng)
        people.append(PosedMeshes(limb(length, radius, "start"), poses, posed_vertices(true, poses)))
    found = improve_shared_weights(people, metric, sweeps=20, tolerance=1e-6)
    assert found.energies[-1] < 1e-4 * found.energies[0]
    np.testing.assert_allclose(found.body.skin.bone_weights(3), limb().skin.bone_weights(3), atol=0.02)


def test_another_rest_pose_leaves_a_rigid_body_where_it_is(rng):
    body = limb(skin="rigid")
    poses = poses_of(body, rng)
    targets = posed_vertices(body, poses)
    moved = rotate_at_rest(
        Person(body, poses, targets, given_of(body), 1e-3), random_pose(body.skeleton, rng, 0.3)
    )
    assert float(jnp.abs(moved.body.vertices - body.vertices).max()) > 0.02
    np.testing.assert_allclose(posed_vertices(moved.body, moved.poses), targets, atol=1e-9)
    # bones at rest are as long as before, and the given joints stay at the joints
    lengths = [
        np.linalg.norm(np.diff(np.asarray(b.skeleton.centres), axis=0), axis=1) for b in (body, moved.body)
    ]
    np.testing.assert_allclose(lengths[0], lengths[1], atol=1e-12)
    np.testing.assert_allclose(moved.given.centres, moved.body.skeleton.centres, atol=1e-12)


def test_people_in_different_rest_poses_are_aligned(rng):
    """Two bodies of one shape at rest in different poses and places become one."""
    body = limb(skin="rigid")
    people = []
    for size in (0.0, 0.3):
        poses = poses_of(body, rng)
        person = Person(body, poses, posed_vertices(body, poses), given_of(body), 1e-3)
        pose = random_pose(body.skeleton, rng, size)
        people.append(rotate_at_rest(person, pose))
    before = np.abs(np.asarray(people[0].body.vertices - people[1].body.vertices)).max()
    aligned = people
    for _ in range(4):
        aligned = align_rest_poses(aligned)
    after = np.abs(np.asarray(aligned[0].body.vertices - aligned[1].body.vertices)).max()
    assert before > 0.05 and after < 0.002
    for person in aligned:
        np.testing.assert_allclose(posed_vertices(person.body, person.poses), person.targets, atol=1e-9)


def test_a_linear_shape_space_is_recovered_with_its_derivatives(rng):
    ends = limb(1.0, 0.06), limb(1.2, 0.06), limb(1.0, 0.08)
    base, modes = ends[0], [jax.tree.map(jnp.subtract, (e.vertices, e.skeleton.centres), (ends[0].vertices, ends[0].skeleton.centres)) for e in ends[1:]]  # fmt: skip
    z = rng.normal(size=(6, 2))

    def made(row):
        return eqx.tree_at(
            lambda b: (b.vertices, b.skeleton.centres),
            base,
            tuple(
                start + sum(share * mode[part] for share, mode in zip(row, modes, strict=True))
                for part, start in enumerate((base.vertices, base.skeleton.centres))
            ),
        )

    bodies = [made(row) for row in z]
    space = make_shape_space(bodies)
    assert space.coefficients.shape == (6, 2)
    np.testing.assert_allclose(space.explained.sum(), 1.0, atol=1e-9)
    # standard deviations of one, not correlated, and a linear function of the true ones
    np.testing.assert_allclose(np.cov(space.coefficients.T), np.eye(2), atol=0.02)
    design = np.column_stack([z, np.ones(6)])
    left = space.coefficients - design @ np.linalg.lstsq(design, space.coefficients)[0]
    np.testing.assert_allclose(left, 0.0, atol=1e-9)
    for body, row in zip(bodies, space.coefficients, strict=True):
        again = jc.shape_body(space.model, row)
        np.testing.assert_allclose(again.vertices, body.vertices, atol=1e-9)
        np.testing.assert_allclose(again.skeleton.centres, body.skeleton.centres, atol=1e-9)
    pose, weights = random_pose(base.skeleton, rng), rng.normal(size=base.vertices.shape)

    def loss(row):
        return jnp.sum(weights * jc.pose_body(jc.shape_body(space.model, row), pose).vertices)

    at, step = jnp.array([0.3, -0.7]), 1e-5
    numeric = [(loss(at.at[k].add(step)) - loss(at.at[k].add(-step))) / (2 * step) for k in range(2)]
    np.testing.assert_allclose(jax.grad(loss)(at), numeric, rtol=1e-6)


def test_poses_are_those_of_the_bodies_of_few_components(rng):
    # one coefficient for the radius leaves none for the length
    bodies = [limb(), limb(1.0, 0.2), limb(1.1, 0.13)]
    poses = [poses_of(body, rng, 2) for body in bodies]
    meshes = [MeshSequence(posed_vertices(b, p), b.faces) for b, p in zip(bodies, poses, strict=True)]
    space = make_shape_space(bodies, 1)
    motions = refit_poses(space, [Motion(p, 30.0) for p in poses], meshes)
    before, after = (
        [
            float(jnp.mean((posed_vertices(person_body(space.model, row), p) - m.vertices) ** 2))
            for row, p, m in zip(space.coefficients, each, meshes, strict=True)
        ]
        for each in (poses, [motion.poses for motion in motions])
    )
    assert all(new <= old for old, new in zip(before, after, strict=True))
    assert sum(after) < 0.8 * sum(before)


def test_rest_poses_that_stay_are_said():
    body = limb()
    assert check_rest_alignment(body.skeleton) == []
    kinds = ["free", "ball", "revolute"]
    hinge = jc.make_skeleton(body.skeleton.names, body.skeleton.parents, kinds, body.skeleton.centres)
    (sentence,) = check_rest_alignment(hinge)
    assert sentence.startswith("Rest poses of people are not aligned") and "(end)" in sentence


def test_joints_far_from_the_surface_are_named():
    bodies = [limb(), limb(1.1), limb(1.2), limb(1.05), limb(1.15, 0.07)]
    space = make_shape_space(bodies)
    assert find_far_joints(space.model, space.coefficients, "abcde") == []
    moved = bodies[1].skeleton.centres.at[2, 0].add(0.12)
    bodies[1] = eqx.tree_at(lambda b: b.skeleton.centres, bodies[1], moved)
    space = make_shape_space(bodies)
    (sentence,) = find_far_joints(space.model, space.coefficients, "abcde")
    assert sentence.startswith("The meshes of b moved joints far") and "end (" in sentence


def test_joints_that_are_bent_in_all_meshes_are_named():
    skeleton = limb().skeleton

    def motion(*degrees):
        turns = [rotation.about_axis(jnp.array([0.0, 0.0, 1.0]), jnp.radians(angle)) for angle in degrees]
        rest = jc.rest_pose(skeleton)
        return stack_poses(
            [eqx.tree_at(lambda p: p.rotations, rest, rest.rotations.at[1].set(turn)) for turn in turns]
        )

    motions = [motion(100.0), motion(70.0, 120.0), motion(20.0), motion(80.0, -95.0)]
    first, second = find_bent_joints(skeleton, motions, "abcd")
    assert first.startswith("No mesh of a is near") and f"{skeleton.names[1]} (100°)" in first
    assert second.startswith("No mesh of d is near") and f"{skeleton.names[1]} (80°)" in second


def test_meshes_are_repeated_to_few_lengths():
    for count in (1, 5, 9, 70):
        rows = repeated_rows(count)
        assert len(rows) == count or len(rows) in LENGTHS
        np.testing.assert_array_equal(rows, np.arange(len(rows)) % count)


def test_repeated_meshes_do_not_count(rng):
    """Q is that of the meshes of each person, and no step depends on repeated ones."""
    true, body = limb(1.1), limb(skin="start")
    poses = poses_of(true, rng, 5)
    targets = posed_vertices(true, poses)
    metric = make_mesh_metric(np.asarray(body.faces), len(body.vertices), 1.0)
    person = repeat_meshes(Person(body, poses, targets, given_of(body), 1e-3))
    assert len(person.targets) == 6 and person.num_meshes == 5
    errors = targets - posed_vertices(body, poses)
    value = sum(float(energy(metric.metric, error)) for error in errors)
    np.testing.assert_allclose(evaluate(person, metric).value, value, rtol=1e-9)
    # any mesh and pose in place of the repeated ones
    others = jax.tree.map(lambda leaf: leaf.at[5].set(leaf[2]), person.poses)
    changed = person._replace(poses=others, targets=person.targets.at[5].add(0.3))
    none = np.zeros((0, 2), int)
    found, again = (improve_people([evaluate(p, metric)], metric, none, False)[0] for p in (person, changed))
    assert found.value < 0.5 * value
    np.testing.assert_allclose(again.value, found.value, rtol=1e-6)
    np.testing.assert_allclose(again.body.vertices, found.body.vertices, atol=1e-7)
    np.testing.assert_allclose(again.body.skeleton.centres, found.body.skeleton.centres, atol=1e-7)
    np.testing.assert_array_equal(again.poses.rotations[5], others.rotations[5])
    rest = [fit_rest_vertices(p.body, p.poses, p.targets, p.frame_weights) for p in (person, changed)]
    np.testing.assert_allclose(*rest, atol=1e-12)


def people_meshes(rng, **people: tuple[float, float]) -> dict[str, MeshSequence]:
    found = {}
    for name, (length, radius) in people.items():
        body = limb(length, radius)
        found[name] = MeshSequence(posed_vertices(body, poses_of(body, rng)), body.faces)
    return found


def test_people_from_whom_nothing_can_be_learned_are_refused(rng):
    people = people_meshes(rng, anna=(1.0, 0.06), ben=(1.2, 0.07))
    assert check_people(people) == []
    anna, ben = people.values()
    with pytest.raises(InputError, match="there is one person, anna, in the meshes"):
        check_people({"anna": anna})
    with pytest.raises(InputError, match="each of the 2 people has one mesh"):
        check_people({"anna": anna[:1], "ben": ben[:1]})
    other = MeshSequence(
        ben.vertices[:, :-SIDES], np.asarray(ben.faces)[(np.asarray(ben.faces) < (RINGS - 1) * SIDES).all(1)]
    )
    with pytest.raises(
        InputError, match=r"the meshes of ben have 128 vertices .* those of anna 136 .*jaxcap register"
    ):
        check_people({"anna": anna, "ben": other})
    with pytest.raises(InputError, match="connect other vertices"):
        check_people({"anna": anna, "ben": MeshSequence(ben.vertices, ben.faces[:, ::-1])})
    # the same triangles in another order, and from another corner on
    assert check_people({"anna": anna, "ben": MeshSequence(ben.vertices, ben.faces[::-1, [1, 2, 0]])}) == []
    both = MeshSequence(jnp.concatenate([anna.vertices, ben.vertices[:2]]), anna.faces)
    (sentence,) = check_people({"both": both, "ben": ben})
    assert "meshes of both may show several people: mesh 4 of both, mesh 5 of both and mesh 0" in sentence


def test_motion_is_that_of_each_person(rng):
    """Different people always differ in shape: this is no motion."""
    anna, ben = people_meshes(rng, anna=(1.0, 0.06), ben=(1.2, 0.07)).values()
    still = [each[np.zeros(3, int)] for each in (anna, ben)]
    with pytest.raises(InputError, match="of each person differ by a rigid motion only"):
        check_people({"anna": still[0], "ben": still[1]})
    with pytest.raises(InputError, match="of each person differ by a rigid motion only"):
        check_people({"anna": still[0], "ben": ben[:1]})
    (sentence,) = check_people({"anna": still[0], "ben": ben})
    assert sentence.startswith("The 3 meshes of anna differ by a rigid motion only")
    assert find_moving([still[0], ben]) == [1]
    skeleton = limb().skeleton
    with pytest.raises(InputError, match="the meshes of anna show no motion; .* such as ben"):
        jc.learn.learn_people({"anna": still[0], "ben": ben}, skeleton=skeleton)


def test_children_and_adults_are_people_of_one_body(rng):
    adult, other, kid = people_meshes(rng, a=(1.8, 0.12), b=(1.7, 0.1), c=(0.7, 0.045)).values()
    (sentence,) = check_people({"adult": adult, "other": other, "kid": kid})
    assert sentence.startswith("kid is 0.4") and "check the unit" in sentence
    inches = MeshSequence(kid.vertices / 0.0254, kid.faces)
    with pytest.raises(InputError, match="mesh 0 of kid is .* times as large as the others; .* one unit"):
        check_people({"adult": adult, "other": other, "kid": inches})
    mixed = MeshSequence(kid.vertices.at[1].multiply(2.54), kid.faces)
    with pytest.raises(InputError, match="mesh 1 of kid is 2.5.* times as large as the others"):
        check_people({"adult": adult, "other": other, "kid": mixed})


def test_people_are_distinguished_by_the_sizes_of_their_surface():
    bodies = [jc.human(resolution="low"), jc.human(resolution="low", sex="female", height=1.55)]
    poses = jc.body.sample_poses(bodies[0].skeleton, count=6)
    shapes = [np.asarray(posed_vertices(body, poses), float) for body in bodies]
    faces = np.asarray(bodies[0].faces)
    assert len(find_people_by_size(shapes[0], faces)) == 1
    groups = find_people_by_size(np.concatenate([shapes[0], shapes[1][:2]]), faces)
    np.testing.assert_array_equal(groups[1], [6, 7])


def test_a_run_is_continued_to_the_same_bits(rng, tmp_path):
    bodies = {name: limb(*size) for name, size in {"a": (1.0, 0.06), "b": (1.2, 0.07)}.items()}
    meshes = {
        name: MeshSequence(posed_vertices(body, poses_of(body, rng)), body.faces)
        for name, body in bodies.items()
    }
    states = []
    options = {"skeleton": bodies["a"].skeleton, "skin": "lbs", "alpha": 1.0, "rounds": 5}
    whole = jc.learn.learn_people(meshes, **options, on_round=states.append)
    starts = [step for step, _ in whole.history].index("start", 1)
    # in the first stage, and in the second one, which begins with another rest pose
    for number in (0, len(states) - 2):
        assert (len(states[number].history) <= starts) == (number == 0)
        path = tmp_path / f"{number}.npz"
        save_checkpoint(path, make_people_checkpoint(states[number], 30.0), {"alpha": 1.0})
        state = load_people_state(path, {"alpha": 1.0}, True, False)
        again = jc.learn.learn_people(meshes, **options, resume=state)
        assert again.history == whole.history
        for found, expected in zip(jax.tree.leaves(again), jax.tree.leaves(whole), strict=True):
            np.testing.assert_array_equal(found, expected)
    with pytest.raises(InputError, match="2 people with 4, 4 meshes"):
        jc.learn.learn_people({**meshes, "b": meshes["b"][:3]}, **options, resume=states[0])
    with pytest.raises(InputError, match="started with alpha"):
        load_people_state(path, {"alpha": 2.0}, True, False)
    with pytest.raises(InputError, match="an unfinished run exists"):
        load_people_state(path, {"alpha": 1.0}, False, False)


@pytest.mark.slow
def test_limbs_of_several_sizes_are_learned(rng):
    """Five limbs of a shape space with two dimensions, one of them with a single mesh near the rest pose: space, joints and poses come back."""
    sizes = {"a": (1.0, 0.06), "b": (1.2, 0.06), "c": (1.0, 0.08), "d": (1.15, 0.075), "e": (1.1, 0.05)}
    bodies = {name: limb(*size) for name, size in sizes.items()}
    poses = {name: poses_of(body, rng, *((1, 0.1) if name == "e" else (6,))) for name, body in bodies.items()}
    rest = stack_poses([jc.rest_pose(bodies["a"].skeleton)]).poses
    poses["a"] = jax.tree.map(lambda *leaves: jnp.concatenate(leaves), rest, poses["a"])
    meshes = {
        name: MeshSequence(posed_vertices(body, poses[name]), body.faces) for name, body in bodies.items()
    }
    learned = jc.learn.learn_people(meshes, skeleton=bodies["a"].skeleton, skin="lbs", alpha=1.0)
    assert learned.names == tuple("abcde") and learned.coefficients.shape[1] <= 4
    assert learned.explained[:2].sum() > 0.97
    for name, row, motion in zip(learned.names, learned.coefficients, learned.motions, strict=True):
        assert len(motion) == len(poses[name].rotations)
        body = jc.shape_body(learned.model, row)
        posed = jc.body.posed_vertices(body, motion.poses)
        off = jnp.linalg.norm(posed - meshes[name].vertices, axis=-1)
        assert float(off.mean()) < 0.003, name
        lengths = np.linalg.norm(np.diff(np.asarray(body.skeleton.centres), axis=0), axis=1)
        np.testing.assert_allclose(lengths[1], 0.35 * sizes[name][0], atol=0.02, err_msg=name)
    # another person of the same space, whose shape and poses are unknowns
    other = limb(1.08, 0.07)
    there = poses_of(other, rng)
    fit = jc.fit_model(learned.model, MeshSequence(posed_vertices(other, there), other.faces))
    assert float(fit.rmse.max()) < 0.006
