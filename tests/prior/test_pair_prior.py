"""Pose priors over pairs of joints: likelihood, both energies, boxes, files, and real motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from helpers import chain_body, check_energy, random_pose
from scipy.stats import multivariate_normal

import jaxcap as jc
from jaxcap.body.body import pose_body
from jaxcap.body.skeleton import dof_layout
from jaxcap.energy.energy import energies
from jaxcap.geometry import rotation
from jaxcap.io.archives.npz import load_body_limits
from jaxcap.io.archives.prior import load_boxes
from jaxcap.limits.abstract_limits import allowed
from jaxcap.limits.rotation_vector_boxes import local_rotation_vectors
from jaxcap.prior.learn_pose_prior import rotation_vectors
from jaxcap.prior.pair_prior import (
    describe_mismatch,
    log_density,
    mixture_mode,
    pair_vectors,
    successive_pairs,
)

BODY = chain_body()
SKELETON = BODY.skeleton


def some_prior(rng, components: int = 3, pad: int = 1):
    """A mixture for each pair of the chain; the second pair has one component less."""
    pairs = successive_pairs(SKELETON)
    count, width = len(pairs), components + pad
    weights = np.zeros((count, width))
    weights[:, :components] = rng.dirichlet(np.full(components, 5.0), count)
    if components > 1:
        weights[1, components - 1] = 0.0
    weights /= weights.sum(1, keepdims=True)
    means = 0.5 * rng.normal(size=(count, width, 6))
    factors = np.tril(rng.normal(size=(count, width, 6, 6))) + 4.0 * np.eye(6)
    frames = [[SKELETON.orientations[SKELETON.index(name)] for name in pair] for pair in pairs]
    return jc.prior.make_pair_prior(pairs, np.array(frames), weights, means, factors)


@pytest.fixture
def prior(rng):
    return some_prior(rng)


def posed_at(vectors) -> jc.Pose:
    """A pose of the chain with given turns (J, 3) in the joints' own frames, whatever their kinds."""
    turns = rotation.exp(rotation.rotate(SKELETON.orientations, vectors))
    rest = jc.rest_pose(SKELETON)
    return jc.Pose(rest.translations, turns, rest.scale)


@eqx.filter_jit
def value(energy, body, pose):
    return jnp.sum(energy.residual(pose_body(body, pose)) ** 2)


def single(rng):
    """One Gaussian for each pair, in whose means all pairs agree, and the pose there."""
    prior = some_prior(rng, 1, 0)
    turns = 0.4 * rng.normal(size=(SKELETON.num_joints, 3))
    means = [np.concatenate([turns[SKELETON.index(name)] for name in pair]) for pair in prior.pairs]
    frames, weights, factors = (np.asarray(a) for a in (prior.frames, prior.weights, prior.factors))
    prior = jc.prior.make_pair_prior(prior.pairs, frames, weights, np.array(means)[:, None], factors)
    return prior, posed_at(jnp.asarray(turns))


def test_pairs_are_of_joints_that_turn_one_after_the_other():
    """Sliding and fixed joints are passed over; the root is in no pair."""
    assert successive_pairs(SKELETON) == (
        ("spine", "chest"), ("chest", "elbow"), ("elbow", "hand"), ("chest", "neck"), ("neck", "jaw"),
    )  # fmt: skip


def test_density_is_that_of_scipy(rng, prior):
    x = pair_vectors(prior, SKELETON, random_pose(SKELETON, rng, 0.4))
    for p, place in enumerate(np.asarray(x)):
        expected = sum(
            w * multivariate_normal(m, np.linalg.inv(c)).pdf(place)
            for w, m, c in zip(prior.weights[p], prior.means[p], prior.precisions[p], strict=True)
        )
        np.testing.assert_allclose(log_density(prior, x)[p], np.log(expected), atol=1e-10)


def test_peaks_are_the_highest_places(rng, prior):
    climb = jax.jit(jax.grad(lambda x: jnp.sum(log_density(prior, x))))
    np.testing.assert_allclose(climb(prior.modes), 0.0, atol=1e-7)
    np.testing.assert_allclose(log_density(prior, prior.modes), prior.log_peaks, atol=1e-12)
    curvature = jax.hessian(lambda x: jnp.sum(log_density(prior, x)))(prior.modes)
    for p, bend in enumerate(prior.curvature_factors):
        np.testing.assert_allclose(
            -bend @ bend.T, curvature[p, :, p], atol=1e-6 * float(jnp.abs(curvature).max())
        )
    for _ in range(200):
        x = prior.means[:, rng.integers(0, 3)] + 0.2 * rng.normal(size=(len(prior.pairs), 6))
        assert (log_density(prior, x) <= prior.log_peaks).all()


def test_the_peak_of_two_that_overlap_is_between_them():
    """Two equal Gaussians 1.5 deviations apart have one peak, in the middle; 4 apart have two."""
    for apart, middle in ((1.5, True), (4.0, False)):
        means = np.zeros((2, 6))
        means[1, 0] = apart
        mode = mixture_mode(np.array([0.5, 0.5]), means, np.tile(np.eye(6), (2, 1, 1)))[0]
        assert (abs(mode[0] - apart / 2) < 1e-4) == middle


@pytest.mark.parametrize("kind", [jc.prior.LikelihoodPrior, jc.prior.MahalanobisPrior])
def test_energies_against_central_differences(rng, prior, kind):
    check_energy(kind(prior), BODY, [random_pose(SKELETON, rng, 0.4) for _ in range(6)], tolerance=1e-5)
    # at and about the peak, where a plain root would have a kink
    one, peak = single(rng)
    near = [
        jc.retract(SKELETON, peak, jnp.asarray(s * rng.normal(size=SKELETON.num_dofs)))
        for s in (0.0, 1e-5, 1e-3)
    ]
    check_energy(kind(one), BODY, near, tolerance=1e-5)


def test_the_likelihood_energy_is_the_equation(rng, prior):
    for size in (0.0, 0.2, 0.5, 2.0):
        pose = random_pose(SKELETON, rng, size)
        expected = 1 - jnp.mean(jc.prior.likelihood(prior, SKELETON, pose))
        found = value(jc.prior.LikelihoodPrior(prior), BODY, pose)
        np.testing.assert_allclose(found, expected, atol=1e-12)
        assert 0 <= found <= 1
    told = energies(
        2.0 * jc.prior.LikelihoodPrior(prior) + jc.prior.MahalanobisPrior(prior), pose_body(BODY, pose)
    )
    assert set(told) == {"LikelihoodPrior", "MahalanobisPrior"}
    np.testing.assert_allclose(told["LikelihoodPrior"], 2 * expected, atol=1e-12)


def test_at_the_peak_there_is_no_energy_and_further_off_there_is_more(rng):
    prior, peak = single(rng)
    for kind in (jc.prior.LikelihoodPrior, jc.prior.MahalanobisPrior):
        assert float(value(kind(prior), BODY, peak)) < 1e-15
        away = jnp.asarray(rng.normal(size=SKELETON.num_dofs))
        costs = [
            float(value(kind(prior), BODY, jc.retract(SKELETON, peak, s * away)))
            for s in (0.0, 0.02, 0.1, 0.3)
        ]
        assert costs == sorted(costs)
        assert costs[1] > 1e-6
    np.testing.assert_allclose(jc.prior.likelihood(prior, SKELETON, peak), 1.0, atol=1e-10)
    # one Gaussian: the mean of squared distances, from the definition
    pose = random_pose(SKELETON, rng, 0.3)
    off = pair_vectors(prior, SKELETON, pose) - prior.means[:, 0]
    expected = np.mean(
        [d @ p[0] @ d for d, p in zip(np.asarray(off), np.asarray(prior.precisions), strict=True)]
    )
    np.testing.assert_allclose(value(jc.prior.MahalanobisPrior(prior), BODY, pose), expected, rtol=1e-10)


def test_a_prior_pulls_a_pose_back(rng):
    """What nothing else tells, the turns of the joints, ends at the likeliest."""
    prior, peak = single(rng)
    peak = jc.body.project(SKELETON, peak)
    start = jc.retract(SKELETON, peak, jnp.asarray(0.3 * rng.normal(size=SKELETON.num_dofs)))
    energy = jc.prior.MahalanobisPrior(prior) + 1e-6 * jc.energy.PosePrior(peak, jnp.ones(SKELETON.num_dofs))
    found = jc.solve(energy, BODY, start)
    assert float(value(jc.prior.MahalanobisPrior(prior), BODY, found.pose)) <= 1.001 * float(
        value(jc.prior.MahalanobisPrior(prior), BODY, peak)
    )


def swinging(frames: int = 240, seed: int = 0) -> jc.Motion:
    """The chain with a hand that follows its elbow, a jaw that never moves and a neck on its own."""
    rng = np.random.default_rng(seed)
    poses = []
    elbow = np.sin(0.15 * np.arange(frames)) + 0.1 * rng.normal(size=frames)
    layout = dof_layout(SKELETON).rotations
    d = np.zeros((frames, SKELETON.num_dofs))
    d[:, layout[SKELETON.index("elbow"), 0]] = 0.6 + 0.5 * elbow
    d[:, layout[SKELETON.index("hand")]] = (0.4 * elbow)[:, None] + 0.1 * rng.normal(size=(frames, 3))
    d[:, layout[SKELETON.index("neck")]] = 0.2 * rng.normal(size=(frames, 3))
    d[:, layout[SKELETON.index("chest")]] = 0.15 * rng.normal(size=(frames, 3))
    d[:, layout[SKELETON.index("spine"), :2]] = 0.1 * rng.normal(size=(frames, 2))
    poses = jax.vmap(lambda step: jc.retract(SKELETON, jc.rest_pose(SKELETON), step))(jnp.asarray(d))
    return jc.Motion(poses, 30.0)


@pytest.fixture(scope="module")
def learned():
    motion = swinging()
    return (
        jc.prior.learn_pair_prior(SKELETON, motion, max_components=3),
        jc.prior.learn_ranges(SKELETON, motion),
        motion,
    )


def test_a_learned_prior_knows_the_coupling_and_what_never_moved(learned):
    prior, _, motion = learned
    assert prior.pairs == successive_pairs(SKELETON)
    assert (np.linalg.eigvalsh(prior.precisions) > 0).all()
    likely = np.asarray(jax.vmap(lambda pose: jc.prior.likelihood(prior, SKELETON, pose))(motion.poses))
    assert (likely >= 0).all()
    assert (likely <= 1).all()
    assert np.median(likely) > 0.03
    # the elbow bent as often seen, the hand turned as often seen, but never both together
    frame = motion[10]
    hand = SKELETON.index("hand")
    other = jc.Pose(frame.translations, frame.rotations.at[hand].set(motion[31].rotations[hand]), frame.scale)
    pair = prior.pairs.index(("elbow", "hand"))
    assert likely[10, pair] > 5 * jc.prior.likelihood(prior, SKELETON, other)[pair]
    # the jaw stayed at rest, to the floor of two degrees
    mode = prior.modes[prior.pairs.index(("neck", "jaw")), 3:]
    np.testing.assert_allclose(mode, 0.0, atol=1e-9)


def test_poses_in_a_stack_and_motions_are_learned_alike(learned):
    prior, _, motion = learned
    halves = [motion.slice(slice(0, 100)), motion.slice(slice(100, None))]
    for poses in (halves, motion.poses):
        again = jc.prior.learn_pair_prior(SKELETON, poses, max_components=3)
        np.testing.assert_array_equal(again.means, prior.means)


def test_ranges_hold_what_was_seen_and_turn_back_what_was_not(rng, learned):
    _, boxes, motion = learned
    assert boxes.joints == ("spine", "chest", "elbow", "hand", "neck", "jaw")
    for frame in range(0, 240, 40):
        assert allowed(boxes, SKELETON, motion[frame]).all()
    vectors = rotation_vectors(SKELETON, motion)[:, SKELETON.index("hand")]
    np.testing.assert_allclose(boxes.lower[boxes.joints.index("hand")], vectors.min(0))
    wild = random_pose(SKELETON, rng, 1.0)
    back = boxes.project(SKELETON, wild)
    assert not allowed(boxes, SKELETON, wild).all()
    assert allowed(boxes, SKELETON, back).all()
    np.testing.assert_array_equal(back.rotations[0], wild.rotations[0])
    np.testing.assert_array_equal(boxes.project(SKELETON, motion[3]).rotations, motion[3].rotations)
    beyond = local_rotation_vectors(SKELETON, wild)[boxes.residual_joints(SKELETON)[::3]].reshape(-1)
    residual = boxes.residual(SKELETON, wild)
    inside = beyond - residual
    np.testing.assert_allclose(inside, jnp.clip(beyond, boxes.lower.ravel(), boxes.upper.ravel()), atol=1e-12)
    # away from the ends of ranges, where slopes have a kink, and at which what never moves stands
    boxes = jc.prior.learn_ranges(SKELETON, motion, margin=0.03)
    check_energy(jc.JointLimits(boxes), BODY, [wild], tolerance=1e-5)


def test_a_prior_of_another_skeleton_is_refused(tmp_path, learned):
    prior, boxes, _ = learned
    path = tmp_path / "prior.npz"
    jc.io.save_prior(path, prior, boxes)
    assert describe_mismatch(prior, SKELETON) is None
    other = jc.make_skeleton(("a", "b"), (-1, 0), ("free", "ball"), np.eye(3)[:2])
    with pytest.raises(jc.InputError, match="another skeleton: there is no joint 'spine' among a, b"):
        jc.io.load_prior(path, other)
    with pytest.raises(jc.InputError, match="joint ranges belong to another skeleton"):
        load_boxes(path, other)
    turned = eqx.tree_at(lambda s: s.orientations, SKELETON, jnp.tile(rotation.identity(), (9, 1)))
    with pytest.raises(jc.InputError, match="the rest frame of .* differs by"):
        jc.io.load_prior(path, turned)
    parents = list(SKELETON.parents)
    parents[SKELETON.index("neck")] = 0
    rehung = jc.make_skeleton(
        SKELETON.names, parents, SKELETON.kinds, SKELETON.centres, SKELETON.orientations
    )
    with pytest.raises(jc.InputError, match="'neck' is not the next rotating joint below 'chest'"):
        jc.io.load_prior(path, rehung)
    body = eqx.tree_at(lambda b: b.skeleton, BODY, rehung)
    with pytest.raises(jc.InputError, match="another skeleton"):
        jc.io.save_prior(tmp_path / "body.npz", prior, body=body)
    with pytest.raises(KeyError, match="no joint 'spine'"):
        jc.prior.likelihood(prior, other, jc.rest_pose(other))


def test_files_alone_and_with_the_body(tmp_path, learned):
    prior, boxes, _ = learned
    alone, beside = tmp_path / "prior.npz", tmp_path / "body.npz"
    jc.io.save_prior(alone, prior, boxes)
    jc.io.save_prior(beside, prior, boxes, BODY, {"angles": np.arange(3.0)})
    for path in (alone, beside):
        again = jc.io.load_prior(path, SKELETON)
        assert again.pairs == prior.pairs
        for one, two in zip(jax.tree.leaves(again), jax.tree.leaves(prior), strict=True):
            np.testing.assert_array_equal(one, two)
        found = load_boxes(path, SKELETON)
        assert found is not None
        np.testing.assert_array_equal(found.upper, boxes.upper)
    np.testing.assert_array_equal(jc.load_body(beside).vertices, BODY.vertices)
    np.testing.assert_array_equal(load_body_limits(beside)["angles"], np.arange(3.0))
    jc.io.save_prior(alone, prior)
    assert load_boxes(alone) is None
    jc.save_body(beside, BODY)
    with pytest.raises(jc.InputError, match="the file contains no pose prior"):
        jc.io.load_prior(beside)


def test_damaged_files_are_told(tmp_path, learned):
    prior, boxes, _ = learned
    path = tmp_path / "prior.npz"
    jc.io.save_prior(path, prior, boxes)
    whole = dict(np.load(path))
    for name, change, told in (
        ("prior.factors", lambda a: -a, "not positive definite"),
        ("prior.weights", lambda a: 2 * a, "at least 0 that sum to 1"),
        ("prior.means", lambda a: a * np.nan, "not positive definite|finite"),
        ("prior.means", lambda a: a[:, :, :5], "has the shape"),
        ("prior.factors", lambda a: a + 1, "not lower triangular"),
    ):
        np.savez(path, **{**whole, name: change(whole[name])})
        with pytest.raises(jc.InputError, match=told):
            jc.io.load_prior(path)
    np.savez(path, **{**whole, "boxes.lower": whole["boxes.upper"] + 1})
    with pytest.raises(jc.InputError, match="swap them"):
        load_boxes(path)


def test_what_is_not_learned_from(learned):
    motion = learned[2]
    for wrong, told in (
        ([], "no motions to learn from"),
        (motion[0], "poses stacked over frames"),
        (motion.slice(slice(0, 3)), "There are 3 poses"),
        (
            jc.stack_poses([jc.rest_pose(jc.make_skeleton(("a",), (-1,), ("free",), np.zeros((1, 3))))]),
            "1 joints",
        ),
    ):
        with pytest.raises(ValueError, match=told):
            jc.prior.learn_pair_prior(SKELETON, wrong)
    broken = eqx.tree_at(lambda m: m.poses.rotations, motion, motion.poses.rotations.at[7].set(jnp.nan))
    with pytest.raises(ValueError, match="Pose 7 is not finite"):
        jc.prior.learn_pair_prior(SKELETON, broken)
    short = jc.make_skeleton(("a", "b"), (-1, 0), ("free", "ball"), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="no joint that rotates with a parent"):
        jc.prior.learn_pair_prior(short, jc.stack_poses([jc.rest_pose(short)] * 9))


@pytest.mark.shared
def test_an_elbow_that_bends_the_other_way_is_less_likely(shared):
    """Learned from real walking, punching and swordplay; elbows and knees bent the other way are hardly
    likely, and beyond the ranges."""
    from jaxcap.io.registry import read_motion

    read = [read_motion(shared / "data" / "motion" / f"02_{n:02}.amc") for n in (1, 5, 7)]
    skeleton = read[0][0]
    motions = [motion.slice(slice(None, None, 20)) for _, motion in read]
    prior, boxes = (
        jc.prior.learn_pair_prior(skeleton, motions, max_components=3),
        jc.prior.learn_ranges(skeleton, motions),
    )
    likely = eqx.filter_jit(jc.prior.likelihood)
    for pair in (
        ("lhumerus", "lradius"),
        ("rhumerus", "rradius"),
        ("lfemur", "ltibia"),
        ("rfemur", "rtibia"),
    ):
        row, joint = prior.pairs.index(pair), skeleton.index(pair[1])
        for motion in motions:
            frame = motion[len(motion) // 3]
            turned = frame.rotations.at[joint].set(rotation.conjugate(frame.rotations[joint]))
            mirrored = jc.Pose(frame.translations, turned, frame.scale)
            assert likely(prior, skeleton, frame)[row] > 100 * likely(prior, skeleton, mirrored)[row]
            assert not allowed(boxes, skeleton, mirrored)[joint]
            assert allowed(boxes, skeleton, frame).all()
