"""Check least squares over many frames with shared unknowns: minima, derivatives, precision, cost.

    python -m benchmarks.one_solver [--frames 120]

On the embedded human with 120 marks on its surface, in float64 but where it is said: a window of tracking (poses, smooth turns), a
calibration (poses, joint centres, rest places of marks), an adaptation (poses, joints with their surface), a calibration from markers, joints
and poses of learning. Each minimum is compared with that of
a dense Gauss-Newton solver, and the derivatives of a shared number or a pose by a weight and by one datum with central
differences. Then the cost of linearising and of solving, with frames doubled three times. Run it from the root of the checkout.
"""

import argparse
import itertools
import time

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from benchmarks.markers._markers import MarkerNoise, scene_of, true_subject
from benchmarks.report import finish, progress
from jaxcap.body.body import Body, pose_body, posed_vertices, take_vertices
from jaxcap.body.people.anatomy import rest_deviations
from jaxcap.body.people.human import human
from jaxcap.body.pose import Motion, Pose, rest_pose
from jaxcap.body.retraction import retract
from jaxcap.body.shape_modes import ShapeModes, joint_modes
from jaxcap.energy.data.landmarks import VertexLandmarks
from jaxcap.energy.priors.reference_pose import RestPrior
from jaxcap.energy.stacked import SmoothRotations, stack_energies
from jaxcap.fit.linear_solvers.block_arrow import BlockArrow
from jaxcap.fit.linear_solvers.block_banded import BlockBanded
from jaxcap.fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from jaxcap.fit.sequences.solve_sequence import solve_sequence
from jaxcap.fit.sequences.unknowns import AbstractUnknown, JointCentres, RestVertices, ShapeCoefficients
from jaxcap.fit.solvers.gauss_newton import GaussNewton
from jaxcap.fit.solvers.levenberg_marquardt import LevenbergMarquardt
from jaxcap.geometry.laplacian import make_conformance
from jaxcap.learn.skeleton.joints import JointProblem, make_curvature
from jaxcap.learn.skeleton.solve_joints import solve_joints
from jaxcap.markers.calibration.calibration_parameters import TemplatePrior, solved_joints
from jaxcap.markers.calibration.calibration_problem import CalibrationEstimate, make_calibration_problem
from jaxcap.markers.calibration.solve_calibration import solve_calibration
from jaxcap.markers.motion.label_matching import match_markers

MARKS = 120
NOISE = 0.003
#: to the end of what the precision shows: data hold some directions by little, and a tolerance of the energy ends long before
REFERENCE_SOLVER, STEPS = LevenbergMarquardt(rtol=0.0, atol=0.0), 400
DENSE = GaussNewton(rtol=1e-15, atol=1e-11, damping=1e-12)
solve = eqx.filter_jit(solve_sequence)


def cast(tree, dtype):
    """Convert all floating-point arrays of a pytree to one precision."""
    return jax.tree.map(lambda leaf: leaf.astype(dtype) if eqx.is_inexact_array(leaf) else leaf, tree)


def human_with_landmarks() -> tuple[Body, ShapeModes]:
    """Make the embedded human with some landmarks instead of its surface, and the modes of its joints."""
    body = cast(human(resolution="low", joints="tracking"), jnp.float64)
    rows = np.random.default_rng(0).choice(len(body.vertices), MARKS, replace=False)
    modes = joint_modes(body)
    return take_vertices(body, jnp.asarray(rows)), ShapeModes(modes.centres[3:], modes.vertices[3:, rows])


def shared_unknowns(body: Body, modes: ShapeModes) -> dict[str, dict[str, AbstractUnknown]]:
    """List the shared unknowns of each recipe."""
    inner = tuple(joint for joint, parent in enumerate(body.skeleton.parents) if parent >= 0)[:8]
    return {
        "tracking": {},
        "calibration": {
            "centres": JointCentres(joints=inner),
            "marks": RestVertices(vertices=tuple(range(32))),
        },
        "adaptation": {"shape": ShapeCoefficients(modes)},
    }


def scene(body: Body, unknowns: dict[str, AbstractUnknown], frames: int) -> tuple[SequenceProblem, Pose]:
    """Make the problem of a smooth motion of another body with noisy data, and its true poses."""
    rng = np.random.default_rng(1)
    skeleton = body.skeleton
    ways = 0.4 * rng.normal(size=(3, skeleton.num_dofs))
    when = np.linspace(0.0, 1.0, frames)[:, None]
    tangents = np.sin(2 * np.pi * (when * np.array([[1.0, 2.0, 3.0]]) + np.array([[0.1, 0.4, 0.7]]))) @ ways
    poses = jax.vmap(retract, (None, None, 0))(skeleton, rest_pose(skeleton), jnp.asarray(tangents))
    names = tuple(f"{name}" for name in unknowns)
    empty = SequenceProblem(
        body,
        VertexLandmarks(jnp.arange(1), jnp.zeros((1, 3)), jnp.ones(1)),
        jnp.arange(float(frames)),
        unknowns,
    )
    start = empty.start(poses).values
    other = jax.tree.map(lambda leaf: leaf + 0.01 * rng.normal(size=leaf.shape), start) if names else start
    true = empty.body_at(other)
    places = jax.lax.map(lambda pose: pose_body(true, pose).vertices, poses)
    places = places + NOISE * rng.normal(size=places.shape)
    rows = jnp.arange(len(body.vertices))
    seen = stack_energies([VertexLandmarks(rows, place, jnp.ones(len(rows))) for place in places])
    near = RestPrior(jnp.asarray(rest_deviations(skeleton)))
    # a prior keeps shared unknowns near the body: rest positions and joints may shift together with the poses
    problem = SequenceProblem(
        body,
        seen + 1e-5 * near,
        jnp.arange(float(frames)),
        unknowns,
        (SmoothRotations(jnp.asarray(1e-3)),),
        (
            1e-2 * VertexLandmarks(rows, body.vertices, jnp.ones(len(rows))),
            *([_fix_centres(body)] if names else []),
        ),
    )
    return problem, poses


def _fix_centres(body: Body):
    from jaxcap.energy.data.landmarks import joint_landmarks

    return 1e-2 * joint_landmarks(body.skeleton.centres)


def derivative_error(problem: SequenceProblem, start: SequenceEstimate) -> float:
    """Compare derivatives of a pose and of shared unknowns, by a weight and by a datum, with central differences, relative to
    the largest."""

    @eqx.filter_jit
    def numbers(changes):
        weight, datum = changes
        there = eqx.tree_at(
            lambda p: (p.frames.terms[1].weight, p.frames.terms[0].energy.targets),
            problem,
            (
                problem.frames.terms[1].weight * (1.0 + weight),
                problem.frames.terms[0].energy.targets.at[1, 5, 0].add(datum),
            ),
        )
        found = solve_sequence(there, start, REFERENCE_SOLVER, STEPS)
        shared = ravel_pytree(found.values)[0]
        return jnp.concatenate([found.poses.rotations[1].ravel(), found.poses.translations[1, 0], shared])

    zero = jnp.zeros(2)
    columns = [jax.jvp(numbers, (zero,), (way,))[1] for way in jnp.eye(2)]
    worst = 0.0
    for way, column, step in zip(jnp.eye(2), columns, (1.5e-2, 1.5e-3), strict=True):
        near, far = ((numbers(h * way) - numbers(-h * way)) / (2 * h) for h in (step, 2 * step))
        apart = jnp.abs((4 * near - far) / 3 - column).max() / jnp.abs(column).max()
        worst = max(worst, float(apart))
    return worst


def compare_minima(problem: SequenceProblem, start: SequenceEstimate) -> dict[str, float]:
    """Compare the minimum with that of a dense solver, and that in float32 with that in float64."""
    found, dense = solve(problem, start, REFERENCE_SOLVER, STEPS), solve(problem, start, DENSE)
    with jax.enable_x64(False):
        single = solve(cast(problem, jnp.float32), cast(start, jnp.float32), REFERENCE_SOLVER, STEPS)

    def places(solution):
        return jax.vmap(lambda pose: pose_body(solution.body, pose).joints)(solution.poses)

    return {
        "energy_difference": abs(float(found.energy / dense.energy) - 1.0),
        "joint_difference_mm": 1000 * float(jnp.abs(places(found) - places(dense)).max()),
        "float32_mm": 1000 * float(jnp.abs(places(found) - places(single)).max()),
        "trustworthy": bool(found.trustworthy),
    }


def marker_recipe() -> dict[str, float]:
    """Check the minimum of a marker calibration: the remaining gain of a dense Newton step, and derivatives of lengths by a
    marker position and by a deviation against central differences."""
    rng = np.random.default_rng(3)
    truth = true_subject(dtype=jnp.float64)
    skeleton = truth.skeleton
    tangents = 0.3 * rng.normal(size=(8, skeleton.num_dofs))
    poses = jax.vmap(retract, (None, None, 0))(skeleton, rest_pose(skeleton), jnp.asarray(tangents))
    seen = scene_of(truth, Motion(poses, 30.0), MarkerNoise(), 0)
    joints = solved_joints(truth, np.ones(truth.num_markers, bool))
    frames = match_markers(truth, seen.frames)
    places = jnp.asarray(frames.positions, jnp.float64)
    # a template that is trusted more than usual, so that differences of minima have enough digits
    trust = TemplatePrior(lengths=0.02, joints=0.002, placements=0.005)
    problem = make_calibration_problem(
        seen.template, places, jnp.asarray(frames.seen), joints, template_prior=trust
    )
    none = jnp.zeros((0, truth.num_markers, 3))
    start = CalibrationEstimate(poses, jnp.zeros(3 * (len(joints) + truth.num_markers)), none)
    ends = jnp.asarray([joint for joint in joints if skeleton.parents[joint] in joints])
    starts = jnp.asarray(skeleton.parents)[ends]

    @eqx.filter_jit
    def lengths(changes, start):
        there = eqx.tree_at(
            lambda p: (p.positions, p.deviations),
            problem,
            (problem.positions.at[2, 7, 1].add(changes[0]), problem.deviations.at[5].add(changes[1])),
        )
        found = solve_calibration(there, start, max_steps=400)
        centres = found.subject.skeleton.centres
        return jnp.linalg.norm(centres[ends] - centres[starts], axis=1), found

    zero = jnp.zeros(2)
    found = lengths(zero, start)[1]
    _, gradient, hessian = problem.normal_equations(found.estimate)
    side, _ = ravel_pytree(gradient)
    left = float(side @ jnp.linalg.solve(hessian.as_matrix(), side)) / float(found.energy)
    worst = 0.0
    for way in jnp.eye(2):
        column = jax.jvp(lambda c: lengths(c, found.estimate)[0], (zero,), (way,))[1]
        near, far = (
            (lengths(h * way, found.estimate)[0] - lengths(-h * way, found.estimate)[0]) / (2 * h)
            for h in (3e-4, 6e-4)
        )
        worst = max(worst, float(jnp.abs((4 * near - far) / 3 - column).max() / jnp.abs(column).max()))
    return {
        "relative_decrement": left,
        "derivative_difference": worst,
        "trustworthy": bool(found.trustworthy),
    }


def learning_recipe() -> dict[str, float]:
    """Check the minimum over learned joints and poses: derivatives of posed vertices by the shape weight and by a datum against
    central differences. The position of a hinge's centre along its axis is unobservable, so bone lengths have no derivative."""
    rng = np.random.default_rng(4)
    body = cast(human(resolution="low", joints="tracking"), jnp.float64)
    skeleton = body.skeleton
    tangents = 0.3 * rng.normal(size=(6, skeleton.num_dofs))
    poses = jax.vmap(retract, (None, None, 0))(skeleton, rest_pose(skeleton), jnp.asarray(tangents))
    targets = posed_vertices(body, poses) + NOISE * rng.normal(size=(6, len(body.vertices), 3))
    metric = make_conformance(np.asarray(body.faces), len(body.vertices), 10.0)
    curvature = make_curvature(metric)

    @eqx.filter_jit
    def places(changes, body, poses):
        there = eqx.tree_at(lambda m: m.alpha, metric, metric.alpha * (1.0 + changes[0]))
        problem = JointProblem(body, targets.at[2, 700, 1].add(changes[1]), there, curvature)
        found = solve_joints(problem, poses, max_steps=200)
        return posed_vertices(found.body, found.poses)[:, ::50], found

    zero = jnp.zeros(2)
    found = places(zero, body, poses)[1]
    worst = 0.0
    # steps are large enough for the changes to be well above the accuracy of the minima
    for way, step in zip(jnp.eye(2), (4e-2, 4e-3), strict=True):
        column = jax.jvp(lambda c: places(c, body, poses)[0], (zero,), (way,))[1]
        near, far = (
            (places(h * way, found.body, found.poses)[0] - places(-h * way, found.body, found.poses)[0])
            / (2 * h)
            for h in (step, 2 * step)
        )
        worst = max(worst, float(jnp.abs((4 * near - far) / 3 - column).max() / jnp.abs(column).max()))
    return {"derivative_difference": worst, "trustworthy": bool(found.trustworthy)}


def min_seconds(function, cases, repeats: int = 5) -> tuple[list[float], list[float]]:
    """Measure the seconds of the first call with each case's arguments, and the minimum of some others.

    The cases take turns, so that other load on the machine affects all of them.
    """

    def seconds(arguments):
        begun = time.perf_counter()
        jax.block_until_ready(function(*arguments))
        return time.perf_counter() - begun

    first = [seconds(arguments) for arguments in cases]
    others = [[seconds(arguments) for arguments in cases] for _ in range(repeats)]
    return first, np.min(others, 0).tolist()


@eqx.filter_jit
def gauss_newton_step(problem: SequenceProblem, y: SequenceEstimate):
    _, gradient, hessian = problem.normal_equations(y)
    return hessian.factorise().solve(gradient)


def solving_seconds(frames: int, dofs: int, shared: int, width: int) -> float:
    """Measure the seconds of factorising and solving random equations in float32."""
    rng = np.random.default_rng(2)
    slopes = rng.normal(size=(frames, dofs + shared, 2 * dofs)).astype(np.float32)
    gram = np.einsum("fir,fjr->fij", slopes, slopes)
    blocks = np.zeros((frames, width, dofs, dofs), np.float32)
    blocks[:, 0] = gram[:, :dofs, :dofs] + 10 * dofs * np.eye(dofs)
    blocks[:, 1:] = 0.1
    arrow = BlockArrow(
        BlockBanded(jnp.asarray(blocks)),
        jnp.asarray(gram[:, :dofs, dofs:]),
        jnp.asarray(gram[:, dofs:, dofs:].sum(0)),
    )
    side = jnp.ones((frames, dofs), jnp.float32), jnp.ones(shared, jnp.float32)
    return min_seconds(jax.jit(lambda arrow, side: arrow.factorise().solve(side)), [(arrow, side)])[1][0]


def main():
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--frames", type=int, default=120, help="number of frames of the second largest problem"
    )
    frames = parser.parse_args().frames
    figures, limits = {}, {}
    body, modes = human_with_landmarks()
    for name, unknowns in shared_unknowns(body, modes).items():
        problem, poses = scene(body, unknowns, 6)
        start = problem.start(poses)
        found = compare_minima(problem, start) | {"derivative_difference": derivative_error(problem, start)}
        progress(f"{name}: {found}")
        figures |= {f"{name}_{key}": value for key, value in found.items()}
        limits |= {
            f"{name}_energy_difference": ("<=", 1e-8),
            f"{name}_derivative_difference": ("<=", 1e-5),
            f"{name}_float32_mm": ("<=", 0.1),
        }
    found = marker_recipe()
    progress(f"markers: {found}")
    figures |= {f"markers_{key}": value for key, value in found.items()}
    limits |= {"markers_relative_decrement": ("<=", 1e-8), "markers_derivative_difference": ("<=", 1e-5)}
    found = learning_recipe()
    progress(f"learning: {found}")
    figures |= {f"learning_{key}": value for key, value in found.items()}
    limits |= {"learning_derivative_difference": ("<=", 1e-5)}
    counts = (frames // 4, frames // 2, frames, 2 * frames)
    scenes = [scene(body, shared_unknowns(body, modes)["adaptation"], count) for count in counts]
    with jax.enable_x64(False):
        single = [cast((problem, problem.start(poses)), jnp.float32) for problem, poses in scenes]
        first, least = min_seconds(gauss_newton_step, single, repeats=12)
    shared = scenes[0][0].num_shared
    for count, before, after in zip(counts, first, least, strict=True):
        figures[f"step_of_{count}_s"], figures[f"first_step_of_{count}_s"] = after, before
        progress(
            f"{count} frames, {shared} shared unknowns: {after:.3f} s per step, first step {before:.1f} s"
        )
    doubled = [later / earlier for earlier, later in itertools.pairwise(least)]
    figures["largest_growth_of_a_doubling"] = max(doubled)
    dofs = body.skeleton.num_dofs
    figures["arrow_120_s"] = solving_seconds(120, dofs, 168, 1)
    figures["band_and_arrow_120_s"] = solving_seconds(120, dofs, 168, 3)
    figures["band_and_arrow_600_s"] = solving_seconds(600, dofs, 168, 3)
    limits |= {
        "largest_growth_of_a_doubling": ("<=", 2.1),
        "arrow_120_s": ("<=", 0.1),
        "band_and_arrow_120_s": ("<=", 0.1),
    }
    finish("one_solver", figures, limits, {"dofs": dofs, "marks": MARKS, "frames": frames})


if __name__ == "__main__":
    main()
