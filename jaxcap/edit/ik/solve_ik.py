"""Solve inverse kinematics at interactive rates."""

from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ...arguments import check_fields, checked
from ...body.body import Body, pose_body
from ...body.people.anatomy import rest_deviations
from ...body.pose import Pose
from ...body.retraction import project
from ...body.skeleton import Skeleton
from ...energy.data.landmarks import VertexLandmarks
from ...energy.energy import AbstractEnergy
from ...energy.priors.joint_limits import JointLimits
from ...energy.priors.reference_pose import ReferencePrior
from ...fit.solve import solve
from ...fit.solvers.gauss_newton import GaussNewton
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.strict_priorities import solve_in_order
from ...limits.abstract_limits import AbstractLimits
from ...value_checks import check_at_least
from .constraints import ORIENTATION_OFFSET, Constraints, constrained_body

Solver = Literal["levenberg-marquardt", "gauss-newton", "priorities"]
SOLVERS: tuple[str, ...] = get_args(Solver)

#: standard deviation of a constraint of weight one, metres
POSITION_DEVIATION = 0.01
#: factor on the weight of a pinned constraint, for weighted solvers
PINNED_FACTOR = 1e3
#: weight of limits per squared radian, for weighted solvers
LIMIT_WEIGHT = 1e6
#: standard deviations of free roots, metres and radians, and of fixed roots, both units; the latter weigh 250
#: times as much as a pinned constraint
FREE_ROOT_DEVIATIONS, FIXED_ROOT_DEVIATION = (0.05, 0.1), 2e-5
#: standard deviation of a joint without anatomical data, radians
DEFAULT_DEVIATION = 0.5


#: metres `(J,)` and radians `(J, 3)`
Deviations = tuple[Float[Array, "J"], Float[Array, "J 3"]]


class IkOptions(eqx.Module):
    """Limits, prior and solver of `solve_ik`. Switches and weights are data, so changing them does not
    recompile."""

    #: `levenberg-marquardt`, `gauss-newton` (Kineben, algorithm 1), or `priorities`: limits, then pinned
    #: constraints, then the others, and the prior last, each without loss to those before
    solver: Solver = eqx.field(static=True, default="levenberg-marquardt")
    limits: AbstractLimits | None = None
    #: prior on poses, in units of standard deviations: `MahalanobisPrior`, `RestPrior`, or a custom one
    prior: AbstractEnergy | None = None
    keep_limits: Bool[Array, ""] = eqx.field(default=True, converter=jnp.asarray)
    use_prior: Bool[Array, ""] = eqx.field(default=True, converter=jnp.asarray)
    #: fix roots at the reference, before all constraints but the limits; a pinned constraint on a root
    #: overrides this for its position, and one with an orientation for its rotation too
    fix_root: Bool[Array, ""] = eqx.field(default=False, converter=jnp.asarray)
    #: weights of the pull to the reference and of the prior, relative to a constraint of weight one that is
    #: `POSITION_DEVIATION` off
    stiffness: Float[Array, ""] = eqx.field(default=0.02, converter=jnp.asarray)
    prior_weight: Float[Array, ""] = eqx.field(default=0.02, converter=jnp.asarray)
    #: largest number of steps of one solve
    max_steps: int = eqx.field(static=True, default=32)

    def __check_init__(self):
        check_fields(self)
        check_at_least("IkOptions", 0, stiffness=self.stiffness, prior_weight=self.prior_weight)
        check_at_least("IkOptions", 1, max_steps=self.max_steps)


class IkSolution(eqx.Module):
    """The result of `solve_ik`."""

    pose: Pose
    #: distance of each constrained point from its target, metres; zero for padding
    distances: Float[Array, "C"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or the reason why the solver stopped before convergence
    result: optx.RESULTS


@checked
def solve_ik(
    body: Body,
    start: Pose,
    constraints: Constraints,
    options: IkOptions | None = None,
    reference: Pose | None = None,
) -> IkSolution:
    """Solve for the pose near a start whose constrained points are nearest to their targets (Kineben, section
    4.2.1).

    Only the constrained vertices are posed, so the size of the body does not matter. Degrees of freedom that
    constraints leave free stay near the `reference` pose, the start if not given. While one target moves,
    keep the reference and start from the last solution; the pose then depends on the positions of the targets
    and not on their paths. Pinned constraints weigh `PINNED_FACTOR` times as much, or have priority if the solver is
    `priorities`.

    If `options.limits` are kept, the pose is within them (`AbstractLimits.project`). Targets out of reach
    give the nearest pose. No error is raised if the solver fails: see `IkSolution.result`.
    """
    options = IkOptions() if options is None else options
    reference = start if reference is None else reference
    if options.solver != "priorities":
        return _solve_weighted(body, start, constraints, options, reference)
    few, groups = _priority_groups(body, constraints, options, reference)
    found = solve_in_order(groups, few, start, max_steps=options.max_steps)
    return _make_solution(few, constraints, options, found.pose, found.num_steps, found.result)


@eqx.filter_jit
def _solve_weighted(body, start, constraints, options, reference) -> IkSolution:
    few = constrained_body(body, constraints)
    # with such weights, plain normal equations would leave no digits for the other points
    solver = GaussNewton() if options.solver == "gauss-newton" else LevenbergMarquardt()
    energy = _target_energy(constraints, jnp.where(constraints.pinned, PINNED_FACTOR, 1.0))
    energy = energy + _regularisation(
        few.skeleton, options, reference, _root_deviations(few.skeleton, constraints, options)
    )
    if options.limits is not None:
        energy = energy + LIMIT_WEIGHT * options.keep_limits * JointLimits(options.limits)
    found = solve(energy, few, start, solver, options.max_steps)
    return _make_solution(few, constraints, options, found.pose, found.num_steps, found.result)


@eqx.filter_jit
def _priority_groups(body, constraints, options, reference) -> tuple[Body, tuple[AbstractEnergy, ...]]:
    """Build the reduced body, and groups of energies in order of priority."""
    few = constrained_body(body, constraints)
    held = _root_deviations(few.skeleton, constraints, options)
    # within their group, pinned constraints have the weight of others
    stay = (1 / PINNED_FACTOR) * ReferencePrior(reference, *held)
    groups = (
        _target_energy(constraints, jnp.where(constraints.pinned, 1.0, 0.0)) + stay,
        _target_energy(constraints, jnp.where(constraints.pinned, 0.0, 1.0)),
        _regularisation(
            few.skeleton, options, reference, jax.tree.map(lambda free: jnp.full_like(free, jnp.inf), held)
        ),
    )
    if options.limits is None:
        return few, groups
    return few, (options.keep_limits * JointLimits(options.limits), *groups)


@eqx.filter_jit
def _make_solution(reduced, constraints, options, pose, num_steps, result) -> IkSolution:
    if options.limits is not None:
        within = project(reduced.skeleton, options.limits.project(reduced.skeleton, pose))
        pose = jax.tree.map(lambda a, b: jnp.where(options.keep_limits, a, b), within, pose)
    distances = jnp.linalg.norm(pose_body(reduced, pose).vertices - constraints.targets, axis=-1)
    return IkSolution(pose, jnp.where(constraints.weights > 0, distances, 0.0), num_steps, result)


def _target_energy(constraints: Constraints, factors: Float[Array, "C"]) -> AbstractEnergy:
    """Build the energy of all points towards their targets, with additional weights."""
    order = jnp.arange(len(constraints.vertices))
    return VertexLandmarks(order, constraints.targets, constraints.weights * factors / POSITION_DEVIATION**2)


def _root_deviations(skeleton: Skeleton, constraints: Constraints, options: IkOptions) -> Deviations:
    """Build the deviations of roots from the reference: small for fixed roots, infinite for other joints."""
    roots, dtype = np.array(skeleton.parents) < 0, skeleton.centres.dtype
    asked = constraints.rigid & constraints.pinned & (constraints.weights > 0)
    arms = jnp.linalg.norm(constraints.rest - skeleton.centres[constraints.bones], axis=-1)

    def deviations(free: Bool[Array, "C"]) -> Float[Array, "J"]:
        loose = jnp.zeros(len(roots), bool).at[constraints.bones].max(free)
        return jnp.where(options.fix_root & roots & ~loose, FIXED_ROOT_DEVIATION, jnp.inf).astype(dtype)

    return deviations(asked), jnp.tile(deviations(asked & (arms > ORIENTATION_OFFSET / 2))[:, None], (1, 3))


def _regularisation(
    skeleton: Skeleton, options: IkOptions, reference: Pose, root_deviations: Deviations
) -> AbstractEnergy:
    """Build the energy of the free degrees of freedom: the reference, with the deviations `root_deviations`, and the
    prior."""
    own, roots = rest_deviations(skeleton, DEFAULT_DEVIATION), np.array(skeleton.parents) < 0
    free = (
        np.full(len(roots), FREE_ROOT_DEVIATIONS[0]),
        np.where(roots[:, None], FREE_ROOT_DEVIATIONS[1], own),
    )
    both = (
        1 / jnp.sqrt(options.stiffness / a**2 + 1 / b**2) for a, b in zip(free, root_deviations, strict=True)
    )
    near = ReferencePrior(reference, *(deviations.astype(skeleton.centres.dtype) for deviations in both))
    return near if options.prior is None else near + options.use_prior * options.prior_weight * options.prior
