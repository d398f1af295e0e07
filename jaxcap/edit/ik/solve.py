"""The pose in which points of a body reach given places, fast enough to follow a hand that drags them."""

from typing import Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from ...arguments import check_fields, checked
from ...body.body import Body, pose_body
from ...body.limits.limits import AbstractLimits
from ...body.people.anatomy import rest_deviations
from ...body.pose import Pose, project
from ...body.skeleton import Skeleton
from ...energy.data.landmarks import VertexLandmarks
from ...energy.energy import AbstractEnergy
from ...energy.priors.limits import JointLimits
from ...energy.priors.prior import ReferencePrior
from ...fit.solve import solve
from ...fit.solvers.gauss_newton import GaussNewton
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...fit.task_priority import solve_in_order
from ...values import check_at_least
from .constraints import ARM, Constraints, constrained_body

Solver = Literal["levenberg-marquardt", "gauss-newton", "priorities"]
SOLVERS: tuple[str, ...] = get_args(Solver)

#: deviation of a constraint of weight one, metres
METRES = 0.01
#: how many times as much a pinned constraint weighs as one that is not, where weights decide
PINNED = 1e3
#: of limits, per squared radian, where weights decide
LIMITS = 1e6
#: how freely roots move before all else has, metres and radians; and hardly at all where they are held, both, which
#: weighs 250 times as much as a pinned constraint
ROOT, HELD = (0.05, 0.1), 2e-5
#: radians of a joint that no anatomy knows
UNKNOWN = 0.5


#: metres `(J,)` and radians `(J, 3)`
Deviations = tuple[Float[Array, "J"], Float[Array, "J 3"]]


class IkOptions(eqx.Module):
    """What a pose is held to besides its constraints, and how it is found. Switches and weights are data, so that
    turning one compiles nothing."""

    #: `levenberg-marquardt`, `gauss-newton` (Kineben, algorithm 1), or `priorities`: limits before pinned
    #: constraints, these before the others, and what is natural last, each without a loss to the ones before
    solver: Solver = eqx.field(static=True, default="levenberg-marquardt")
    limits: AbstractLimits | None = None
    #: which poses are likely, in units of deviations: `MahalanobisPrior`, `RestPrior`, or one's own
    prior: AbstractEnergy | None = None
    keep_limits: Bool[Array, ""] = eqx.field(default=True, converter=jnp.asarray)
    use_prior: Bool[Array, ""] = eqx.field(default=True, converter=jnp.asarray)
    #: keep roots where they are, before all constraints but the limits; where a pinned constraint is on a root
    #: itself, that says where it is, and with an orientation how it is turned
    hold_root: Bool[Array, ""] = eqx.field(default=False, converter=jnp.asarray)
    #: of the pull to the reference, and of the prior, where a constraint of weight one is `METRES` off
    stiffness: Float[Array, ""] = eqx.field(default=0.02, converter=jnp.asarray)
    naturalness: Float[Array, ""] = eqx.field(default=0.02, converter=jnp.asarray)
    #: most steps of one solve
    max_steps: int = eqx.field(static=True, default=32)

    def __check_init__(self):
        check_fields(self)
        check_at_least("IkOptions", 0, stiffness=self.stiffness, naturalness=self.naturalness)
        check_at_least("IkOptions", 1, max_steps=self.max_steps)


class IkSolution(eqx.Module):
    """The outcome of `solve_ik`."""

    pose: Pose
    #: how far each point of the constraints is from its target, metres; zero where it is padding
    distances: Float[Array, "C"]
    num_steps: Int[Array, ""]
    #: `RESULTS.successful`, or why the solver stopped before it converged
    result: optx.RESULTS


@checked
def solve_ik(
    body: Body,
    start: Pose,
    constraints: Constraints,
    options: IkOptions | None = None,
    reference: Pose | None = None,
) -> IkSolution:
    """The pose near a start in which constrained points are nearest to their targets (Kineben, section 4.2.1).

    Only the constrained vertices are posed, whatever the size of the body. What constraints leave free stays near
    the `reference` pose, the start where it is not given: while one target moves, keep the reference and start
    from the last solution, and the pose depends on where the targets are and not on the way there. Pinned
    constraints weigh `PINNED` times as much, or come first where the solver is `priorities`.

    Where `options.limits` are kept, the pose is within them (`AbstractLimits.nearest`). Targets out of reach end in
    the nearest pose. Nothing is raised where the solver fails: see `IkSolution.result`.
    """
    options = IkOptions() if options is None else options
    reference = start if reference is None else reference
    if options.solver != "priorities":
        return _solve_weighted(body, start, constraints, options, reference)
    few, groups = _in_order(body, constraints, options, reference)
    found = solve_in_order(groups, few, start, max_steps=options.max_steps)
    return _finished(few, constraints, options, found.pose, found.num_steps, found.result)


@eqx.filter_jit
def _solve_weighted(body, start, constraints, options, reference) -> IkSolution:
    few = constrained_body(body, constraints)
    # pinned points weigh so much that normal equations as they are would have no digits left for the others
    solver = GaussNewton() if options.solver == "gauss-newton" else LevenbergMarquardt()
    energy = _reach(constraints, jnp.where(constraints.pinned, PINNED, 1.0))
    energy = energy + _natural(few.skeleton, options, reference, _held(few.skeleton, constraints, options))
    if options.limits is not None:
        energy = energy + LIMITS * options.keep_limits * JointLimits(options.limits)
    found = solve(energy, few, start, solver, options.max_steps)
    return _finished(few, constraints, options, found.pose, found.num_steps, found.result)


@eqx.filter_jit
def _in_order(body, constraints, options, reference) -> tuple[Body, tuple[AbstractEnergy, ...]]:
    """The small body, and groups of energies with the first first."""
    few = constrained_body(body, constraints)
    held = _held(few.skeleton, constraints, options)
    # in their group pinned constraints weigh what others do elsewhere
    stay = (1 / PINNED) * ReferencePrior(reference, *held)
    groups = (
        _reach(constraints, jnp.where(constraints.pinned, 1.0, 0.0)) + stay,
        _reach(constraints, jnp.where(constraints.pinned, 0.0, 1.0)),
        _natural(
            few.skeleton, options, reference, jax.tree.map(lambda free: jnp.full_like(free, jnp.inf), held)
        ),
    )
    if options.limits is None:
        return few, groups
    return few, (options.keep_limits * JointLimits(options.limits), *groups)


@eqx.filter_jit
def _finished(few, constraints, options, pose, num_steps, result) -> IkSolution:
    if options.limits is not None:
        within = project(few.skeleton, options.limits.nearest(few.skeleton, pose))
        pose = jax.tree.map(lambda a, b: jnp.where(options.keep_limits, a, b), within, pose)
    apart = jnp.linalg.norm(pose_body(few, pose).vertices - constraints.targets, axis=-1)
    return IkSolution(pose, jnp.where(constraints.weights > 0, apart, 0.0), num_steps, result)


def _reach(constraints: Constraints, more: Float[Array, "C"]) -> AbstractEnergy:
    """All points at their targets, weighted besides by so much."""
    order = jnp.arange(len(constraints.vertices))
    return VertexLandmarks(order, constraints.targets, constraints.weights * more / METRES**2)


def _held(skeleton: Skeleton, constraints: Constraints, options: IkOptions) -> Deviations:
    """How freely roots leave the reference where they are held, and all else does."""
    roots, dtype = np.array(skeleton.parents) < 0, skeleton.centres.dtype
    asked = constraints.rigid & constraints.pinned & (constraints.weights > 0)
    arms = jnp.linalg.norm(constraints.rest - skeleton.centres[constraints.bones], axis=-1)

    def deviations(free: Bool[Array, "C"]) -> Float[Array, "J"]:
        loose = jnp.zeros(len(roots), bool).at[constraints.bones].max(free)
        return jnp.where(options.hold_root & roots & ~loose, HELD, jnp.inf).astype(dtype)

    return deviations(asked), jnp.tile(deviations(asked & (arms > ARM / 2))[:, None], (1, 3))


def _natural(skeleton: Skeleton, options: IkOptions, reference: Pose, held: Deviations) -> AbstractEnergy:
    """What decides where constraints do not: the reference, besides what is held to it, and which poses are likely."""
    own, roots = rest_deviations(skeleton, UNKNOWN), np.array(skeleton.parents) < 0
    free = np.full(len(roots), ROOT[0]), np.where(roots[:, None], ROOT[1], own)
    both = (1 / jnp.sqrt(options.stiffness / a**2 + 1 / b**2) for a, b in zip(free, held, strict=True))
    near = ReferencePrior(reference, *(deviations.astype(skeleton.centres.dtype) for deviations in both))
    return near if options.prior is None else near + options.use_prior * options.naturalness * options.prior
