"""A template becomes an actor: equations against differences, each step's gain, and the whole way."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import fails, runs
from helpers import chain_body, random_pairs, random_pose

import jaxcap as jc
from jaxcap.adapt.adapt_body import adapt_body
from jaxcap.adapt.adapt_round import gauss_newton_step
from jaxcap.adapt.objective import (
    CoefficientPrior,
    PoseTerms,
    mean_squared_distance,
    shared_problem,
    temporal_energy,
)
from jaxcap.adapt.poses.fit_frame import fit_pose, pairs_of
from jaxcap.adapt.poses.sliding_window import smooth_poses
from jaxcap.adapt.shape.actor_size import fit_size
from jaxcap.adapt.shape.joint_regressor import make_joint_regressor, regress_joints
from jaxcap.adapt.shape.shape_prior import body_shape_prior
from jaxcap.adapt.shape.vertex_adaptation import adapt_shape
from jaxcap.adapt.task import TO_TRIANGLES, AdaptSettings, AdaptTask, plan_stages
from jaxcap.body.body import scale_body
from jaxcap.body.people.walk_and_wave import walk_and_wave
from jaxcap.body.retraction import retract
from jaxcap.body.shape_modes import ShapeModes, apply_modes, joint_modes
from jaxcap.body.symmetry import find_left_right_pairs
from jaxcap.energy.data.pairs import PairDistances, pair_directions, pair_positions
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.fit.correspondence.find_pairs import Matching
from jaxcap.fit.correspondence.nearest_assignment import NearestOnSurface, make_scan
from jaxcap.fit.correspondence.soft_assignment import SoftAssignment
from jaxcap.fit.frame_equations import frame_equations
from jaxcap.fit.linearise import body_tangent, frame_jacobian, vertex_maps
from jaxcap.geometry import rotation
from jaxcap.geometry.mesh import mesh_edges, sample_surface
from jaxcap.stacking import stack_trees, unstack_trees

BODY = chain_body("swing_twist")
PRIOR = RestPrior(jnp.full((BODY.skeleton.num_joints, 3), 0.7))
ON_SURFACE = Matching(assignment=NearestOnSurface())
SOFT = Matching(assignment=SoftAssignment(sigma=0.01))


def some_modes(rng, kind: str) -> ShapeModes:
    """Joints with their skin, joints within it, or a few ways in which everything moves."""
    if kind != "people":
        return joint_modes(BODY, move_surface=kind == "joints")
    shapes = (4, BODY.skeleton.num_joints, 3), (4, len(BODY.vertices), 3)
    return ShapeModes(*(jnp.asarray(0.1 * rng.normal(size=shape)) for shape in shapes))


@pytest.mark.parametrize(("corners", "kind"), [(1, "joints"), (3, "within"), (1, "people")])
def test_rows_of_poses_and_modes_against_central_differences(rng, corners, kind):
    """The residual of pairs by every number of the pose and every amount of a mode."""
    pairs, modes = random_pairs(BODY, rng, corners=corners), some_modes(rng, kind)
    pose, dofs, energy = random_pose(BODY.skeleton, rng, 0.6), BODY.skeleton.num_dofs, PairDistances(pairs)

    @eqx.filter_jit
    def residual(d):
        body = apply_modes(BODY, modes, d[dofs:])
        return energy.residual(jc.pose_body(body, retract(BODY.skeleton, pose, d[:dofs])))

    @eqx.filter_jit
    def rows():
        tangent = body_tangent(lambda z: apply_modes(BODY, modes, z), BODY, len(modes.centres))
        return frame_jacobian(energy, BODY, pose, None, tangent)

    zero, h = np.zeros(dofs + len(modes.centres)), 1e-6
    expected = np.stack([(residual(zero + h * e) - residual(zero - h * e)) / (2 * h) for e in np.eye(len(zero))], 1)  # fmt: skip
    value, found = rows()
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(value, residual(zero), atol=1e-12)


@pytest.mark.parametrize(("corners", "shared"), [(1, False), (1, True), (3, True)])
def test_equations_of_a_frame_are_those_of_its_rows(rng, corners, shared):
    """Sum more pairs than there are vertices with another term; pairs at single vertices are summed over these first."""
    pairs, modes = random_pairs(BODY, rng, 3 * len(BODY.vertices), corners), some_modes(rng, "people")
    energy = 0.3 * (2.0 * PairDistances(pairs)) + 0.1 * PRIOR
    pose = random_pose(BODY.skeleton, rng, 0.6)

    @eqx.filter_jit
    def both():
        def at(z):
            return apply_modes(BODY, modes, z)

        body_at, tangent = (at, body_tangent(at, BODY, len(modes.centres))) if shared else (None, None)
        residual, rows = frame_jacobian(energy, BODY, pose, body_at, tangent)
        written = 0.5 * residual @ residual, rows.T @ residual, rows.T @ rows
        return written, frame_equations(energy, BODY, pose, body_at, tangent)

    for expected, found in zip(*both(), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-13 * float(jnp.max(jnp.abs(expected))))


def test_shape_is_the_dense_least_squares_solution(rng):
    """Pairs of two frames, the Laplacian in two poses, and the hold, in one residual and its Jacobian."""
    pairs = stack_trees([random_pairs(BODY, rng, 300, 3) for _ in range(2)])
    poses = stack_trees([random_pose(BODY.skeleton, rng, 0.5) for _ in range(2)])
    prior, weight, hold = body_shape_prior(BODY, 2), 0.7, 1e-3
    laplacian = jnp.asarray(prior.laplacian.toarray())

    def residual(shift):
        body = eqx.tree_at(lambda b: b.vertices, BODY, BODY.vertices + shift.reshape(-1, 3))
        meshes, own = (
            jax.vmap(lambda pose: jc.pose_body(body, pose).vertices)(p) for p in (prior.poses, poses)
        )
        places = jnp.stack(
            [pair_positions(p, mesh) for p, mesh in zip(unstack_trees(pairs, 2), own, strict=True)]
        )
        apart = jnp.einsum("fcra,fca->fcr", jax.vmap(pair_directions)(pairs), places - pairs.points)
        rough = jnp.sqrt(weight / 2) * (jnp.einsum("uv,mva->mua", laplacian, meshes) - prior.vectors)
        return jnp.concatenate([jnp.sqrt(hold) * shift, apart.reshape(-1), rough.reshape(-1)])

    zero = jnp.zeros(BODY.vertices.size)
    slope, apart = jax.jit(lambda d: (jax.jacfwd(residual)(d), residual(d)))(zero)
    step = np.linalg.lstsq(np.asarray(slope), -np.asarray(apart), rcond=None)[0].reshape(-1, 3)
    found = adapt_shape(BODY, poses, pairs, prior, weight, hold, 1e-12).vertices - BODY.vertices
    np.testing.assert_allclose(found, step, atol=1e-8 * np.abs(step).max())
    assert np.abs(step).max() > 0.01


def test_a_vertex_is_the_corner_of_a_triangle(rng):
    """Pairs at vertices give the shape that they give as points in triangles that have all of one share."""
    pairs = stack_trees([random_pairs(BODY, rng, 300)])
    faces = np.asarray(BODY.faces)
    near = faces[[np.flatnonzero((faces == v).any(1))[0] for v in np.asarray(pairs.vertices[0, :, 0])]]
    shares = jnp.asarray(near == np.asarray(pairs.vertices[0]), float)
    wide = eqx.tree_at(lambda p: (p.vertices, p.barycentric), pairs, (jnp.asarray(near)[None], shares[None]))
    poses, prior = stack_trees([random_pose(BODY.skeleton, rng, 0.5)]), body_shape_prior(BODY, 2)
    one, other = (adapt_shape(BODY, poses, p, prior, 0.7, tolerance=1e-13).vertices for p in (pairs, wide))
    np.testing.assert_allclose(one, other, atol=1e-10)
    assert np.abs(one - BODY.vertices).max() > 0.01


def test_shape_refuses_pairs_across_the_body(rng):
    pairs = random_pairs(BODY, rng, corners=3)
    edges = {frozenset(edge) for edge in mesh_edges(np.asarray(BODY.faces)).tolist()}
    far = next(v for v in range(1, len(BODY.vertices)) if frozenset((0, v)) not in edges)
    pairs = eqx.tree_at(
        lambda p: p.vertices, pairs, pairs.vertices.at[9].set(jnp.array([0, far, 0], jnp.int32))
    )
    pose = stack_trees([jc.rest_pose(BODY.skeleton)])
    prior = body_shape_prior(BODY, 2)
    with pytest.raises(ValueError, match=f"vertices 0 and {far}, which share no edge"):
        adapt_shape(BODY, pose, stack_trees([pairs]), prior, 1.0)


def test_a_posed_vertex_depends_linearly_on_its_place_at_rest(rng):
    pose = random_pose(BODY.skeleton, rng, 0.8)
    maps, places = eqx.filter_jit(vertex_maps)(BODY, pose)
    shift = jnp.asarray(rng.normal(size=BODY.vertices.shape))
    there = eqx.tree_at(lambda b: b.vertices, BODY, BODY.vertices + shift)
    expected = jc.pose_body(there, pose).vertices
    np.testing.assert_allclose(places + jnp.einsum("vab,vb->va", maps, shift), expected, atol=1e-9)


def test_the_surface_follows_all_its_joints_alike():
    """A body whose joints are all shifted alike is shifted whole."""
    shift = jnp.array([0.1, -0.2, 0.3])
    there = apply_modes(BODY, joint_modes(BODY), jnp.tile(shift, BODY.skeleton.num_joints))
    np.testing.assert_allclose(there.vertices, BODY.vertices + shift, atol=1e-9)
    np.testing.assert_allclose(there.skeleton.centres, BODY.skeleton.centres + shift, atol=1e-9)


def test_joints_go_where_the_surface_around_them_goes(rng):
    regressor = make_joint_regressor(BODY)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = 1.3 * np.asarray(BODY.vertices) @ turn.T + [1.0, 2.0, 3.0]
    expected = 1.3 * np.asarray(BODY.skeleton.centres) @ turn.T + [1.0, 2.0, 3.0]
    np.testing.assert_allclose(regress_joints(regressor, moved), expected, atol=1e-9)


def test_second_differences_of_even_motion_are_none(rng):
    free = np.isin(BODY.skeleton.kinds, ("ball", "free"))[:, None]
    # round more than once in all
    axis = jnp.asarray(rng.normal(size=(BODY.skeleton.num_joints, 3)) * free)
    rest = jc.rest_pose(BODY.skeleton)
    turned = [jc.Pose(rest.translations, rotation.exp(k * axis), rest.scale) for k in range(9)]
    assert float(temporal_energy(BODY.skeleton, stack_trees(turned))) < 1e-20
    shaken = [
        p if k % 2 else jc.Pose(p.translations, turned[k // 2].rotations, p.scale)
        for k, p in enumerate(turned)
    ]
    assert float(temporal_energy(BODY.skeleton, stack_trees(shaken))) > 1e-5


@pytest.fixture(scope="module")
def scene():
    """A template, an actor of other build, and twelve scans of the actor's walk."""
    template = jc.human(resolution="low", joints="tracking")
    actor = jc.human(resolution="low", joints="tracking", height=1.66, weight=0.7)
    motion = walk_and_wave(actor.skeleton, seconds=0.4)
    posed, clouds = eqx.filter_jit(jc.pose_body), []
    for frame in range(len(motion)):
        rng = np.random.default_rng(frame)
        vertices = np.asarray(posed(actor, motion[frame]).vertices, float)
        points, normals = sample_surface(vertices, np.asarray(actor.faces), 2000, rng)
        clouds.append(jc.make_cloud(points + 0.002 * rng.normal(size=points.shape), normals))
    return template, actor, motion, clouds


def human_prior(body):
    return RestPrior(jnp.full((body.skeleton.num_joints, 3), 0.7))


@pytest.mark.parametrize(("matching", "far"), [(Matching(), 0.08), (ON_SURFACE, 0.08), (SOFT, 0.02)])
def test_a_pose_is_found_from_near_by(scene, rng, matching, far):
    _, actor, motion, clouds = scene
    prior, scan = human_prior(actor), make_scan(clouds[5])
    away = jnp.asarray(far * rng.normal(size=actor.skeleton.num_dofs))
    start = retract(actor.skeleton, motion[5], away)
    found = fit_pose(actor, scan, start, PoseTerms(prior), matching, steps=15)
    joints = [np.asarray(jc.pose_body(actor, pose).joints) for pose in (start, found.pose, motion[5])]
    off = [np.linalg.norm(some - joints[2], axis=1).mean() for some in joints[:2]]
    assert off[1] < 0.004
    assert 3 * off[1] < off[0]


def test_size_is_told_by_scans(scene):
    _, actor, motion, clouds = scene
    large = scale_body(actor, jnp.asarray(1.12))
    root = large.skeleton.centres[0] - actor.skeleton.centres[0]
    pose = motion[0]
    pose = jc.Pose(pose.translations.at[0].add(-root), pose.rotations, pose.scale)
    _, _, size = fit_size(large, [make_scan(clouds[0])], [pose], PoseTerms(human_prior(actor)), Matching())
    assert size == pytest.approx(1 / 1.12, rel=0.01)


def test_clothes_make_nobody_larger(scene):
    """Points 2 cm outside of the skin pull a larger body over themselves, whose soles and crown would be outside of the scan."""
    _, actor, motion, _ = scene
    vertices = np.asarray(jc.pose_body(actor, motion[0]).vertices, float)
    points, normals = sample_surface(vertices, np.asarray(actor.faces), 2000, np.random.default_rng(0))
    clothed = points + 0.02 * normals * np.array([1.0, 0.0, 1.0])
    scan, terms = make_scan(jc.make_cloud(clothed, normals)), PoseTerms(human_prior(actor))
    body, (pose,), size = fit_size(actor, [scan], [motion[0]], terms, TO_TRIANGLES)
    heights = np.asarray(jc.pose_body(body, pose).vertices)[:, 1]
    assert size < 1.05
    assert clothed[:, 1].min() - 0.03 < heights.min()
    assert heights.max() < clothed[:, 1].max() + 0.03


@pytest.mark.parametrize("matching", [Matching(), ON_SURFACE])
def test_joints_and_vertices_come_nearer_in_every_round(scene, matching):
    template, actor, motion, clouds = scene
    frames = [0, 4, 8, 11]
    scans, prior = [make_scan(clouds[n]) for n in frames], human_prior(template)
    body = scale_body(template, jnp.asarray(1.66 / 1.75))
    poses = [
        fit_pose(body, s, motion[n], PoseTerms(prior), matching, steps=8).pose
        for s, n in zip(scans, frames, strict=True)
    ]
    shape, regressor, modes = body_shape_prior(body), make_joint_regressor(body), joint_modes(body)
    terms, deviation = PoseTerms(prior, jnp.asarray(1e-6)), jnp.asarray(0.003)
    left_right_pairs = find_left_right_pairs(body.skeleton)

    def pairs():
        return stack_trees([pairs_of(body, p, s, matching) for p, s in zip(poses, scans, strict=True)])

    def distance():
        each = [
            mean_squared_distance(body, p, pairs_of(body, p, s, matching))
            for p, s in zip(poses, scans, strict=True)
        ]
        return 1000 * float(np.sqrt(np.mean(each)))

    told = [distance()]
    for _ in range(3):
        shifts = regress_joints(regressor, np.asarray(body.vertices)) - np.asarray(body.skeleton.centres)
        coefficient_prior = CoefficientPrior(jnp.asarray(shifts).reshape(-1), jnp.full(shifts.size, 0.005))
        problem = shared_problem(body, pairs(), terms, modes, coefficient_prior, left_right_pairs, deviation)
        body, several, _ = gauss_newton_step(problem, stack_trees(poses))
        poses = unstack_trees(several, len(frames))
        body = adapt_shape(body, stack_trees(poses), pairs(), shape, 10.0)
        told.append(distance())
    assert told[0] > told[1] > told[2] > told[3]
    # what the true body leaves is noise
    truth = [mean_squared_distance(actor, motion[n], pairs_of(actor, motion[n], s, matching)) for s, n in zip(scans, frames, strict=True)]  # fmt: skip
    floor = 1000 * float(np.sqrt(np.mean(truth)))
    assert told[3] - floor < 0.5 * (told[0] - floor)
    left, right = body.skeleton.index("LeftForeArm"), body.skeleton.index("RightForeArm")
    parents = np.array(body.skeleton.parents)
    lengths = np.linalg.norm(
        np.asarray(body.skeleton.centres) - np.asarray(body.skeleton.centres)[parents], axis=1
    )
    assert lengths[left] == pytest.approx(lengths[right], abs=1e-4)


def test_windows_smooth_a_motion_and_hold_where_they_meet(scene, rng):
    _, actor, motion, clouds = scene
    prior, scans = human_prior(actor), [make_scan(cloud) for cloud in clouds]
    shaken = [
        retract(actor.skeleton, motion[n], jnp.asarray(0.02 * rng.normal(size=actor.skeleton.num_dofs)))
        for n in range(len(motion))
    ]
    smooth = smooth_poses(
        actor,
        shaken,
        lambda n, pose: pairs_of(actor, pose, scans[n], Matching()),
        PoseTerms(prior),
        1e-2,
        frames=7,
        stride=4,
    )
    rough = [float(temporal_energy(actor.skeleton, stack_trees(poses))) for poses in (shaken, smooth)]
    assert rough[1] < 0.1 * rough[0]
    joints = [np.asarray(jc.pose_body(actor, poses[6]).joints) for poses in (shaken, smooth, [motion[6]] * 7)]
    off = [np.linalg.norm(some - joints[2], axis=1).mean() for some in joints[:2]]
    assert off[1] < off[0]


@pytest.mark.slow
def test_the_whole_way_and_again_from_the_middle(scene):
    template, actor, motion, clouds = scene
    task = AdaptTask(template, clouds.__getitem__, len(clouds), 30.0, motion[0], human_prior(template),
                find_left_right_pairs(template.skeleton), AdaptSettings(num_frames=6, proportion_rounds=3, rounds=(2, 2)))  # fmt: skip
    states = list(adapt_body(task))
    last = states[-1]
    assert last.done == len(plan_stages(task.settings))
    assert last.lost == ()
    assert last.size == pytest.approx(1.66 / 1.75, rel=0.03)
    # what the true body leaves is noise
    frames = np.unique(np.linspace(0, len(clouds) - 1, 8).astype(int)).tolist()
    truth = [mean_squared_distance(actor, motion[n], pairs_of(actor, motion[n], make_scan(clouds[n]), Matching())) for n in frames]  # fmt: skip
    floor = 1000 * float(np.sqrt(np.mean(truth)))
    assert last.history[-1][1] - floor < 0.5 * (last.history[0][1] - floor)
    again = list(adapt_body(task, states[6]))
    np.testing.assert_array_equal(again[-1].body.vertices, last.body.vertices)
    np.testing.assert_array_equal(again[-1].motion.poses.rotations, last.motion.poses.rotations)


@pytest.mark.slow
def test_a_body_is_adapted_while_it_is_tracked(scene):
    """After every frame of the first ten: the body is nearer to the actor before the last frames are tracked."""
    template, actor, motion, clouds = scene
    settings = AdaptSettings(num_frames=4, every=1, proportion_rounds=2, rounds=(1,), temporal_weight=0.0)
    task = AdaptTask(template, clouds.__getitem__, len(clouds), 30.0, motion[0], human_prior(template),
                find_left_right_pairs(template.skeleton), settings)  # fmt: skip
    states = list(adapt_body(task))
    before, after = (next(s for s, stage in zip(states, plan_stages(settings), strict=True) if str(stage) == name)
                     for name in ("track to frame 1", "track"))  # fmt: skip
    # what the true body leaves is noise
    truth = [mean_squared_distance(actor, motion[n], pairs_of(actor, motion[n], make_scan(clouds[n]), Matching())) for n in range(8)]  # fmt: skip
    floor = 1000 * float(np.sqrt(np.mean(truth)))
    assert after.history[-1][1] - floor < 0.7 * (before.history[-1][1] - floor)
    assert states[-1].lost == ()


@pytest.mark.slow
def test_the_command_line_adapts_and_goes_on(scene, tmp_path, capsys):
    _, _, motion, clouds = scene
    points = np.stack([np.asarray(cloud.points)[np.asarray(cloud.weights) > 0] for cloud in clouds])
    normals = np.stack([np.asarray(cloud.normals)[np.asarray(cloud.weights) > 0] for cloud in clouds])
    np.savez(tmp_path / "scans.npz", points=points, normals=normals)
    template = jc.human(resolution="low", joints="tracking")
    jc.save_motion(tmp_path / "start.npz", motion, template.skeleton)
    jc.save_body(tmp_path / "template.npz", template)
    words = ("adapt", tmp_path / "template.npz", tmp_path / "scans.npz", "-o", tmp_path / "actor.npz",
             "--start", tmp_path / "start.npz", "--frames", 5, "--smoothness", 0)  # fmt: skip
    told = runs(capsys, *words)
    assert "times the template's size" in told
    assert len(jc.load_motion(tmp_path / "actor-motion.npz")) == len(clouds)
    assert not (tmp_path / "actor.npz.partial").exists()
    assert "already exists" in fails(capsys, *words)
    assert "this run is already complete" in runs(capsys, *words, "--resume")


def test_what_is_refused(tmp_path, capsys):
    np.savez(tmp_path / "two.npz", points=np.random.default_rng(0).normal(size=(2, 900, 3)))
    words = ("adapt", "human:low", tmp_path / "two.npz", "-o")
    assert "written as .npz" in fails(capsys, *words, tmp_path / "a.obj")
    assert "--frames is 1" in fails(capsys, *words, tmp_path / "a.npz", "--frames", 1)
    assert "not written as '.fbx'" in fails(
        capsys, *words, tmp_path / "a.npz", "--motion", tmp_path / "m.fbx"
    )


def test_joints_of_left_and_right_are_found_by_their_names():
    skeleton = jc.human(resolution="low").skeleton
    names = {(skeleton.names[a], skeleton.names[b]) for a, b in find_left_right_pairs(skeleton)}
    assert ("LeftArm", "RightArm") in names
    assert ("LThumb", "RThumb") in names
    assert ("LHipJoint", "RHipJoint") in names
