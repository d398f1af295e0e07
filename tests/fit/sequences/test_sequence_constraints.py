"""What unknowns of a sequence are kept to: bounds, held frames, bones of equal length; and what of them nothing shows."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
from helpers import chain_body, random_pose
from jax.flatten_util import ravel_pytree

from jaxcap.body.body import pose_body
from jaxcap.body.pose import stack_poses
from jaxcap.body.skeleton import dof_layout
from jaxcap.body.skin import RigidSkin
from jaxcap.energy.data.landmarks import VertexLandmarks
from jaxcap.energy.energy import Weighted
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.energy.stacked import NormalPrior, SmoothRotations, stack_energies
from jaxcap.errors import InputError
from jaxcap.fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from jaxcap.fit.sequences.solve_sequence import solve_sequence
from jaxcap.fit.sequences.uncertainty import describe_sequence, sequence_uncertainty
from jaxcap.fit.sequences.unknowns import JointCentres, JointOrientations, RestVertices, Size, SkinningWeights
from jaxcap.fit.solvers.gauss_newton import GaussNewton
from jaxcap.fit.solvers.implicit import is_trustworthy
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt
from jaxcap.fit.solvers.minimise import minimise

BODY = chain_body()
SKELETON = BODY.skeleton
FRAMES = 4
TIGHT = LevenbergMarquardt(rtol=0.0, atol=1e-13)
REST = RestPrior(jnp.ones((SKELETON.num_joints, 3)))
CENTRES = {"centres": JointCentres((5, 7))}
#: the bones of the two arms of the fork, which differ by 4 cm
MIRRORED = ((5, 8),)

solve_ = eqx.filter_jit(solve_sequence)


@pytest.fixture(scope="module")
def frames():
    """Noisy places of all vertices of a chain in four poses."""
    rng = np.random.default_rng(11)
    poses = [random_pose(SKELETON, rng, 0.4) for _ in range(FRAMES)]
    marks = []
    for pose in poses:
        places = pose_body(BODY, pose).vertices
        marks.append(
            VertexLandmarks(
                jnp.arange(len(places)), places + 0.003 * rng.normal(size=places.shape), jnp.ones(len(places))
            )
        )
    return stack_energies(marks) + 1e-3 * REST, stack_poses(poses, 1.0).poses


def problem_of(frames, unknowns, **more) -> SequenceProblem:
    return SequenceProblem(BODY, frames[0], jnp.arange(float(FRAMES)), unknowns, **more)


def test_any_unknown_of_the_body_is_linearised(frames):
    """Skinning weights change nothing that has a closed form here."""
    unknowns = {
        "weights": SkinningWeights((3, 7, 20), (1, 2, 4)),
        "turns": JointOrientations((2, 5)),
        "centres": JointCentres((1, 2)),
    }
    problem = problem_of(frames, unknowns)
    y = problem.start(frames[1])
    residual, jacobian = eqx.filter_jit(problem.linearise)(y)
    _, gradient, hessian = eqx.filter_jit(problem.normal_equations)(y)
    assert np.abs(jacobian[:, -6:]).max() > 1e-2
    np.testing.assert_allclose(ravel_pytree(gradient)[0], jacobian.T @ residual, atol=1e-10)
    np.testing.assert_allclose(hessian.as_matrix(), jacobian.T @ jacobian, atol=1e-9)


def test_skinning_weights_stay_on_their_simplex():
    weights = SkinningWeights((3, 7), (1, 2, 4))
    start = weights.start(BODY)
    for size in (0.01, 10.0):
        moved = weights.retract(start, size * jnp.asarray([1.0, -1.0, 0.5, 2.0]))
        assert (moved >= 0).all()
        np.testing.assert_allclose(moved.sum(1), start.sum(1), rtol=1e-12)
    body = weights.apply(BODY, moved)
    np.testing.assert_allclose(body.skin.weights.sum(1), 1.0, rtol=1e-12)
    with pytest.raises(InputError, match="a SwingTwistSkin has no matrix of weights"):
        weights.start(chain_body("swing_twist"))


def test_held_frames_and_equal_bones_are_kept_together(frames):
    held = jnp.asarray([False, True, False, False])
    found = solve_(problem_of(frames, CENTRES, fixed=held, left_right_pairs=MIRRORED), frames[1], TIGHT)
    assert found.trustworthy
    for part, start in zip(jax.tree.leaves(found.poses), jax.tree.leaves(frames[1]), strict=True):
        np.testing.assert_allclose(part[1], start[1], rtol=1e-14, atol=1e-15)
    centres = np.asarray(found.body.skeleton.centres)
    lengths = [np.linalg.norm(centres[a] - centres[SKELETON.parents[a]]) for a in MIRRORED[0]]
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-9)


def test_a_start_beyond_a_bound_is_brought_within(frames):
    found = solve_(problem_of(frames, {"size": Size(1.2, 1.5)}), frames[1], TIGHT, 200)
    assert float(jnp.exp(found.values["size"])) == pytest.approx(1.2, abs=1e-12)
    assert found.trustworthy
    problem = problem_of(frames, {"size": Size(1.2, 1.5)})
    outside = SequenceEstimate(frames[1], {"size": jnp.asarray(0.0)})
    ended = eqx.filter_jit(minimise)(problem, outside, TIGHT, 1)
    ended = eqx.tree_at(lambda m: (m.y, m.result), ended, (outside, optx.RESULTS.successful))
    assert not is_trustworthy(problem, ended)


def test_uncertainty_is_within_what_is_kept(frames):
    """Against the dense inverse on the null space of what is held and of equal bones."""
    held = jnp.asarray([False, False, True, False])
    problem = problem_of(
        frames, CENTRES, fixed=held, left_right_pairs=MIRRORED, between=(SmoothRotations(jnp.asarray(1e-3)),)
    )
    found = solve_(problem, frames[1], TIGHT, 400)
    known = sequence_uncertainty(problem, found, variance=0.5)
    y = SequenceEstimate(found.poses, found.values)
    matrix = np.asarray(eqx.filter_jit(problem.normal_equations)(y)[2].as_matrix())
    rows = np.asarray(problem.information(y).constraints.equalities.rows)
    dofs, last = SKELETON.num_dofs, FRAMES * SKELETON.num_dofs
    kept = np.zeros((dofs + len(rows), len(matrix)))
    kept[:dofs, 2 * dofs : 3 * dofs] = np.eye(dofs)
    kept[dofs:, last:] = rows
    free = np.linalg.svd(kept)[2][len(kept) :].T
    dense = 0.5 * free @ np.linalg.inv(free.T @ matrix @ free) @ free.T
    np.testing.assert_allclose(known.shared, dense[last:, last:], rtol=1e-6, atol=1e-12)
    for frame in range(FRAMES):
        block = slice(frame * dofs, (frame + 1) * dofs)
        np.testing.assert_allclose(known.poses[frame], dense[block, block], rtol=1e-6, atol=1e-11)
    assert not np.any(known.poses[2])
    assert describe_sequence(problem, known) == []


@pytest.fixture(scope="module")
def open_ended(frames):
    """The centre of a joint of which nothing that it moves is seen, beside one that is."""
    weights = jnp.where(BODY.skin.weights < 1e-2, 0.0, BODY.skin.weights)
    body = eqx.tree_at(lambda b: b.skin.weights, BODY, weights / weights.sum(1, keepdims=True))
    marks, near = frames[0].terms
    seen = jnp.broadcast_to(jnp.where(weights[:, 8] > 0, 0.0, 1.0), (FRAMES, len(weights)))
    marks = eqx.tree_at(lambda m: m.energy.weights, marks, seen)
    return SequenceProblem(body, marks + near, jnp.arange(float(FRAMES)), {"centres": JointCentres((5, 8))})


def test_what_nothing_holds_has_no_part_in_derivatives_and_no_end_to_its_variance(frames, open_ended):
    def centres(datum):
        there = eqx.tree_at(
            lambda p: p.frames.terms[0].energy.targets,
            open_ended,
            open_ended.frames.terms[0].energy.targets.at[1, 2, 0].add(datum),
        )
        found = solve_sequence(there, frames[1], TIGHT, 400)
        return found.values["centres"], found

    slope, found = eqx.filter_jit(jax.jacfwd(centres, has_aux=True))(jnp.asarray(0.0))
    assert found.trustworthy
    assert np.abs(slope[0]).max() > 1e-5
    np.testing.assert_allclose(slope[1], 0.0, atol=1e-6 * np.abs(slope[0]).max())
    known = sequence_uncertainty(open_ended, found)
    deviations = np.sqrt(np.diag(known.shared))
    assert np.isfinite(deviations[:3]).all() and (deviations[:3] > 0).all()
    assert np.isinf(deviations[3:]).all()
    assert int(known.unobservable.sum()) == 3
    assert sum("centres[5]" in line for line in describe_sequence(open_ended, known)) >= 1


def test_what_only_rounding_shows_has_no_end_to_its_variance(frames):
    """A vertex in the middle of the last joint does not turn with it, but for the last bits of its place."""
    last = SKELETON.num_joints - 1
    parts = np.asarray(BODY.skin.dominant_bones())
    vertex = int(np.flatnonzero(parts == last)[0])
    body = eqx.tree_at(
        lambda b: (b.vertices, b.skin),
        BODY,
        (BODY.vertices.at[vertex].set(SKELETON.centres[last]), RigidSkin(jnp.asarray(parts))),
    )
    seen = jnp.where((parts != last) | (np.arange(len(parts)) == vertex), 1.0, 0.0)
    marks = eqx.tree_at(
        lambda m: m.energy.weights, frames[0].terms[0], jnp.broadcast_to(seen, (FRAMES, len(seen)))
    )
    problem = SequenceProblem(body, marks, jnp.arange(float(FRAMES)), {})
    found = sequence_uncertainty(problem, solve_(problem, frames[1], TIGHT, 50), variance=1e-6)
    turns = [
        number
        for number, name in enumerate(dof_layout(SKELETON).names)
        if name.startswith(SKELETON.names[last])
    ]
    still = np.asarray(found.unobservable_poses)
    assert still[:, turns].all()
    assert not np.delete(still, turns, 1).any()


@pytest.mark.parametrize(
    ("solver", "more", "words"),
    [
        (optx.BFGS(1e-6, 1e-6), {"unknowns": {"size": Size(0.9, 1.1)}}, "bounds of the unknown 'size'"),
        (GaussNewton(), {"unknowns": CENTRES, "left_right_pairs": MIRRORED}, "bones of equal length"),
    ],
)
def test_solvers_that_keep_no_constraints_are_refused(frames, solver, more, words):
    with pytest.raises(
        InputError, match=f"{type(solver).__name__} does not support constraints, but the problem has {words}"
    ):
        solve_sequence(problem_of(frames, **more), frames[1], solver)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"unknowns": {"part": JointCentres((999,))}},
            "JointCentres 'part': `joints` has 999, and the body has 9",
        ),
        ({"unknowns": {"part": JointCentres((3, 3))}}, "`joints` has 3 twice"),
        ({"unknowns": {"part": RestVertices((10**6,))}}, "`vertices` has 1000000"),
        (
            {"times": jnp.zeros(FRAMES), "between": (SmoothRotations(jnp.asarray(1.0)),)},
            "strictly increasing times",
        ),
        ({"shared": (NormalPrior("sise", jnp.zeros(1), jnp.ones(1)),)}, "there is no unknown 'sise'"),
        ({"left_right_pairs": MIRRORED, "unknowns": {}}, "there are no `unknowns`; give some"),
        ({"left_right_pairs": ((5, 99),)}, "`left_right_pairs` has 99"),
        ({"left_right_pairs": MIRRORED, "unknowns": {"size": Size(0.5, 2.0)}}, "cannot be combined"),
    ],
)
def test_what_cannot_be_solved_is_a_sentence(frames, change, words):
    fields = {
        "body": BODY,
        "frames": frames[0],
        "times": jnp.arange(float(FRAMES)),
        "unknowns": CENTRES,
        **change,
    }
    with pytest.raises(InputError, match=words):
        solve_sequence(SequenceProblem(**fields), frames[1])


def test_fields_of_a_problem_are_looked_at(frames):
    problem = problem_of(frames, CENTRES, fixed=jnp.zeros(FRAMES, bool))
    for field, value, words in (
        ("unknowns", [Size()], "expected a dict of unknowns by name"),
        ("fixed", jnp.zeros(3, bool), "3 in `fixed`"),
    ):
        wrong = eqx.tree_at(lambda p, field=field: getattr(p, field), problem, value)
        with pytest.raises(InputError, match=words):
            solve_sequence(wrong, frames[1])


def test_numbers_that_are_no_sizes_or_weights_are_told(frames):
    with pytest.raises(InputError, match="`smallest` is -1; expected a factor above 0"):
        Size(-1.0, 2.0)
    for weight in (-1.0, jnp.nan):
        terms = eqx.tree_at(lambda e: e.terms[1].weight, frames[0], jnp.asarray(weight))
        with pytest.raises(InputError, match="RestPrior: its weight is"):
            solve_sequence(SequenceProblem(BODY, terms, jnp.arange(float(FRAMES))), frames[1])
    assert isinstance(frames[0].terms[1], Weighted)


def test_a_later_frame_is_looked_at_too(frames):
    marks = eqx.tree_at(
        lambda e: e.terms[0].energy.vertices,
        frames[0],
        frames[0].terms[0].energy.vertices.at[3, 0].set(10**6),
    )
    with pytest.raises(InputError, match="`vertices` has 1000000"):
        solve_sequence(SequenceProblem(BODY, marks, jnp.arange(float(FRAMES))), frames[1])
