"""Learn an animatable body from registered meshes by alternating minimisation of Q."""

import logging
from collections.abc import Callable
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..arguments import checked
from ..body.body import Body, take_vertices
from ..body.pose import Motion, Pose
from ..body.skeleton import Skeleton
from ..compiled import forget_many_compiled
from ..energy.check_energies import UserTerms, sum_user_terms
from ..energy.energy import AbstractEnergy, sum_energies
from ..fit.precision import with_precision
from ..geometry.laplacian import Conformance, make_conformance
from ..observe.meshes import MeshSequence
from .anatomy.choose_skeleton import SkeletonName, choose_skeleton
from .anatomy.close_joints import close_joints
from .anatomy.find_person import PlacedPerson
from .decimated_meshes import DecimatedMeshes, coarse_alpha, decimate_meshes, num_coarse_vertices
from .full_resolution import transfer_to_all_vertices
from .initialise import (
    InitialBody,
    SkinName,
    initialise_free_bones,
    initialise_from_motion,
    initialise_from_person,
    initialise_from_skeleton,
)
from .joint_exchange.exchange_joints import exchange_joints
from .joint_exchange.insert_and_remove import EditedBody
from .objective import in_units_of_vertices, objective
from .parts.find_parts import MAX_SYMMETRY_COST
from .skeleton.given_centres import GivenCentres, carry_given
from .skeleton.joints import Curvature, improve_joints, make_curvature
from .skeleton.limbs import has_only_ball_joints
from .state import LearnState
from .symmetry.choose_symmetry import FoundSymmetry, choose_symmetry, judge_motion
from .symmetry.surface_symmetry import SurfaceSymmetry
from .symmetry.symmetric_skeleton import middle_directions
from .variable_projection.learning_rounds import VERTICES, improve_linear_skin
from .variable_projection.solve_blend_problem import optimise_all_vertices
from .weights.improve_weights import improve_weights
from .weights.rest_vertices import solve_rest_vertices

_LOG = logging.getLogger(__name__)

#: rounds on a mesh end when one lowers Q by less than this share
MIN_DECREASE = 8e-3
#: the share of all rounds that may be spent on the coarse mesh
COARSE_SHARE = 2 / 3
#: below this alpha, bodies with a linear skin are learned by variable projection
MAX_PROJECTION_ALPHA = 1.0
#: initial damping for joints and poses
FIRST_DAMPING = 1e-3
#: updates of joints and poses, some steps each: before the first round, and in each round
FIRST_STEPS, STEPS = 2, 1
#: rounds before joints are first exchanged, rounds of each trial, and the most trials
EXCHANGE_AFTER, TRIAL_ROUNDS, TRIALS = 3, 2, 3
#: the most sweeps over the weights in the first round on a mesh, and in later ones
FIRST_SWEEPS, SWEEPS = 8, 4
#: prefix of the names of steps on the coarse mesh in the history
COARSE_PREFIX = "coarse "


#: whether joints are exchanged, and whether their number is fixed
ExchangeMode = Literal["no", "fixed", "free"]


class Learned(NamedTuple):
    """A learned body, the poses of its meshes, and the history of learning."""

    body: Body
    motion: Motion
    #: pairs of left and right joints
    left_right_pairs: Int[np.ndarray, "P 2"]
    #: (step, Q) after the start and after every update; Q never rises
    history: tuple[tuple[str, float], ...]
    #: root mean square error over the number of rigid parts, metres; empty if it was not computed
    curve: Float[np.ndarray, "N"]
    #: where the anatomy or a given skeleton has the joints in the rest shape; None if they were found from the motion
    given: GivenCentres | None = None
    #: the left-right symmetry of the surface by which joints were paired; None if it was not found or not searched
    symmetry: SurfaceSymmetry | None = None
    #: a sentence about this symmetry, or why there is none; empty if it was not searched
    symmetry_message: str = ""


@checked
def learn_body(
    meshes: MeshSequence,
    *,
    joints: int | None = None,
    skin: SkinName = "swing_twist",
    alpha: float = 100.0,
    symmetry: bool | Literal["always"] | Int[np.ndarray, "P 2"] = True,
    skeleton: Skeleton | PlacedPerson | SkeletonName = "automatic",
    fix_joints: bool = False,
    free_bones: bool = False,
    rounds: int = 30,
    terms: UserTerms = (),
    on_round: Callable[[LearnState], None] | None = None,
    resume: LearnState | None = None,
) -> Learned:
    """Learn a body that follows registered meshes of one actor (Adaptation, section 3.2).

    Rigid parts, joints and poses are initialised first (3.2.1). Then skinning weights, rest vertices, and
    joints with all poses are updated in turn. Each update lowers

        Q = sum |x - T(v)|^2 + alpha |L(x - T(v))|^2        (eq. 3.19)

    until a round lowers it by little, or for at most `rounds` rounds. A mesh with many vertices is first
    learned on a subset of them (`decimate_meshes`), then on all.

    **Arguments:** `joints` is the number of joints between parts; None chooses it from the motion, and joints
    must then be worth their cost. `skin` is the skinning model. `alpha` weighs shape against distance.
    `symmetry` keeps left and right bones equally long, in pairs that are found or given as `(P, 2)`
    indices of joints. Pairs are those of a skeleton's names. Without names they follow from the symmetry of the surface
    (`find_symmetry`), or from lengths and areas if it has none or if its two sides move differently; "always" pairs these, too. `skeleton` "human" begins with the named joints of the human skeleton, placed in one of the
    meshes (`find_person`); they are a prior on the joint centres, and joints on the middle of the body stay there. "none"
    searches for joints freely. "automatic" is "human" if a person is recognised and neither `joints` nor `free_bones` nor pairs are
    given. A `Skeleton`, posed as in the first mesh, replaces the detected joints: as a prior on
    joint centres, or as fixed centres with `fix_joints`. `free_bones` learns bones without parents and with
    linear blending. `terms` is an energy or several of the posed body with all vertices, which act on joints
    and poses: one unit weighs as much as a mean vertex error of a millimetre. With `terms`, no joints are
    exchanged. `on_round` is called with the state after every round. `resume` continues from a state, with
    the same result.

    **Raises:** `ValueError` with one sentence for meshes or options from which nothing can be learned, and
    `InputError` for energies of vertices or joints that do not exist.
    """
    meshes = with_precision(meshes, jnp.result_type(float))
    whole = sum_energies((terms,) if isinstance(terms, AbstractEnergy) else terms)
    always = isinstance(symmetry, str)
    symmetry = True if isinstance(symmetry, str) else symmetry
    max_symmetry_cost = np.inf if always else MAX_SYMMETRY_COST
    tree = _choose(meshes, skeleton, joints, symmetry, free_bones) if resume is None else resume.body.skeleton
    given = tree is not None if resume is None else resume.given is not None
    # energies belong to the current tree of joints
    exchanging: ExchangeMode = "no" if given or whole is not None else "free" if joints is None else "fixed"
    known = tree.body.skeleton if isinstance(tree, PlacedPerson) else tree
    simple = known is None or has_only_ball_joints(known)
    # pairs with names, and those that the user gives, need no search
    is_searched = symmetry is True and not given and not free_bones
    loose = skin == "lbs" and alpha < MAX_PROJECTION_ALPHA and whole is None and simple
    found = choose_symmetry(meshes, is_exact=loose and not always) if is_searched else FoundSymmetry(None, "")
    coarse = decimate_meshes(meshes, VERTICES if loose else num_coarse_vertices(joints))
    thinned = len(coarse.kept) < meshes.vertices.shape[1]
    if resume is None:
        _LOG.info("segmenting rigid parts and estimating joints")
        # heat weights need the whole mesh, terms need all vertices, and an unknown number of joints is found more surely on all
        on_coarse = joints is not None and not given and whole is None
        mirror = found.symmetry
        some = mirror.decimated(coarse.kept, coarse.nearest) if mirror is not None and on_coarse else mirror
        mirrors = some, max_symmetry_cost
        start = _start(
            coarse.meshes if on_coarse else meshes, joints, skin, symmetry, tree, free_bones, mirrors
        )
        sum_user_terms("learn_body", terms, start.body)
        motion = Motion(start.poses, meshes.rate)
        state = LearnState(start.body, motion, start.left_right_pairs, FIRST_DAMPING, (), 0, start.curve)
        state = state._replace(symmetry_cost=start.symmetry_cost)
        if start.given is not None:
            state = state._replace(given=start.given._replace(is_fixed=fix_joints))
        if thinned and not on_coarse:
            state = state._replace(body=_thin(state.body, coarse))
    else:
        state = resume
    mirror, message = judge_motion(found, state.symmetry_cost, max_symmetry_cost)
    if len(state.body.vertices) < meshes.vertices.shape[1]:
        stage = _stage(
            coarse.meshes,
            coarse_alpha(alpha, len(coarse.nearest), len(coarse.kept)),
            COARSE_PREFIX,
            symmetry=None if mirror is None else mirror.decimated(coarse.kept, coarse.nearest),
        )
        state = _improve(state, stage, round(COARSE_SHARE * rounds), on_round, exchanging, loose)
        _LOG.info("transferring the body to all vertices")
        body = transfer_to_all_vertices(state.body, state.motion.poses, coarse, meshes)
        if loose:
            body = optimise_all_vertices(body, state.motion.poses, meshes.vertices)[0]
        state = state._replace(body=body)
    energies = in_units_of_vertices(whole, meshes.vertices.shape[1])
    fine = _stage(meshes, alpha, "", energies, mirror)
    # no exchange on the fine mesh after one on the coarse mesh
    if not (thinned and loose):
        state = _improve(state, fine, rounds, on_round, "no" if thinned else exchanging, loose)
    kept = state.body, state.motion, state.left_right_pairs, state.history, state.curve, state.given
    return Learned(*kept, mirror, message)


class _Stage(NamedTuple):
    """The meshes that rounds work on, their metric, and the prefix of their steps in the history."""

    meshes: MeshSequence
    metric: Conformance
    curvature: Curvature
    prefix: str
    terms: AbstractEnergy | None
    symmetry: SurfaceSymmetry | None


def _stage(
    meshes: MeshSequence,
    alpha: float,
    prefix: str,
    terms: AbstractEnergy | None = None,
    symmetry: SurfaceSymmetry | None = None,
) -> _Stage:
    metric = make_conformance(np.asarray(meshes.faces), meshes.vertices.shape[1], alpha)
    return _Stage(meshes, metric, make_curvature(metric), prefix, terms, symmetry)


def _value(body: Body, poses: Pose, stage: _Stage) -> float:
    """Evaluate Q and the user's energies."""
    return float(objective(body, poses, stage.meshes.vertices, stage.metric, stage.terms))


def _choose(
    meshes: MeshSequence,
    skeleton: Skeleton | PlacedPerson | SkeletonName,
    joints: int | None,
    symmetry: bool | np.ndarray,
    free_bones: bool,
) -> Skeleton | PlacedPerson | None:
    """Return the skeleton with which learning begins; None for a free search."""
    if not isinstance(skeleton, str):
        return skeleton
    if joints is not None or free_bones:
        if skeleton == "human":
            raise ValueError("The human skeleton has its own joints; omit `joints` and `free_bones`.")
        return None
    if skeleton == "automatic" and not isinstance(symmetry, bool):
        # the numbers of pairs are those of joints found from the motion
        return None
    placed, sentence = choose_skeleton(meshes, skeleton)
    _LOG.info(sentence)
    return placed


def _start(meshes, joints, skin, symmetry, tree, free_bones, mirrors) -> InitialBody:
    if free_bones:
        return initialise_free_bones(meshes, joints)
    if isinstance(tree, PlacedPerson):
        return initialise_from_person(meshes, tree, skin, symmetry)
    if tree is not None:
        return initialise_from_skeleton(meshes, tree, skin, symmetry)
    return initialise_from_motion(meshes, joints, skin, symmetry, *mirrors)


def _thin(body: Body, coarse: DecimatedMeshes) -> Body:
    return take_vertices(body, jnp.asarray(coarse.kept), coarse.meshes.faces)


def _improve(
    state: LearnState,
    stage: _Stage,
    rounds: int,
    on_round: Callable[[LearnState], None] | None,
    exchanging: ExchangeMode,
    loose: bool,
) -> LearnState:
    """Run rounds on one mesh until one lowers Q by little, or until the most rounds are reached.

    After the first few rounds, and when rounds gain little, superfluous joints are exchanged for missing
    ones, until that gains nothing either.
    """
    if not _values(state, stage):
        value = _value(state.body, state.motion.poses, stage)
        state = state._replace(history=(*state.history, (stage.prefix + "start", value)))
        if state.round == 0 and not loose:
            state = _improve_joints(state, stage, FIRST_STEPS)
    if loose:
        kind = exchanging != "no", exchanging == "free", stage.prefix, stage.symmetry
        return improve_linear_skin(state, stage.meshes.vertices, rounds, on_round, *kind)
    while state.round < rounds:
        settled = _settled(state, stage)
        first = state.round >= EXCHANGE_AFTER and not _has(state, stage, "exchange")
        before = state.history[-1][1]
        if exchanging != "no" and (first or settled):
            state = _exchange(state, stage, exchanging == "free")
            if settled and state.history[-1][1] > (1 - MIN_DECREASE) * before:
                break
        elif settled and state.history[-1][1] > (1 - MIN_DECREASE) * before:
            break
        if state.round < rounds:
            state = _round(state, stage)
            if on_round is not None:
                on_round(state)
    return state


def _exchange(state: LearnState, stage: _Stage, free: bool) -> LearnState:
    targets = stage.meshes.vertices
    _LOG.info("exchanging joints")

    def improve(before: LearnState, made: EditedBody) -> LearnState:
        value = _value(made.body, made.poses, stage)
        after = before._replace(
            body=made.body,
            motion=Motion(made.poses, before.motion.rate),
            left_right_pairs=made.left_right_pairs,
            damping=FIRST_DAMPING,
            history=(*before.history, (stage.prefix + "edit", value)),
        )
        for number in range(TRIAL_ROUNDS):
            after = _round(after, stage, far=number == 0)
        return after

    tries, step = TRIALS if free else TRIALS - 1, stage.prefix + "exchange"
    return exchange_joints(state, targets, improve, step, tries, free, stage.symmetry)


def _has(state: LearnState, stage: _Stage, step: str) -> bool:
    return any(name == stage.prefix + step for name, _ in state.history)


def _values(state: LearnState, stage: _Stage) -> list[float]:
    """Return Q after every step on this mesh."""
    first = stage.prefix + "start"
    names = [name for name, _ in state.history]
    return [value for _, value in state.history[names.index(first) :]] if first in names else []


def _settled(state: LearnState, stage: _Stage) -> bool:
    """Test whether the last round on this mesh lowered Q by little."""
    values, length = _values(state, stage), 2 + STEPS
    # an exchange is not part of a round
    if any(name == stage.prefix + "exchange" for name, _ in state.history[-length:]):
        return False
    return len(values) > 2 * length and values[-1] > (1 - MIN_DECREASE) * values[-1 - length]


def _round(state: LearnState, stage: _Stage, far: bool = False) -> LearnState:
    # each number of joints has its own compiled functions
    forget_many_compiled()
    poses, targets = state.motion.poses, stage.meshes.vertices
    # the first update on a mesh needs more sweeps
    far = far or not _has(state, stage, "weights")
    effort = FIRST_SWEEPS if far else SWEEPS
    _LOG.info("round %d: weights", state.round + 1)
    better = improve_weights(state.body, poses, targets, stage.metric, sweeps=effort, coarse=far).body
    state = _keep(state, better, stage, "weights")
    _LOG.info("round %d: rest vertices", state.round + 1)
    rest = solve_rest_vertices(state.body, poses, targets, stage.metric)
    before = state.body
    state = _keep(state, eqx.tree_at(lambda b: b.vertices, state.body, rest), stage, "vertices")
    state = state._replace(given=carry_given(state.given, before, state.body.vertices))
    _LOG.info("round %d: joints and poses", state.round + 1)
    state = _improve_joints(state, stage, STEPS)
    return state._replace(round=state.round + 1)


def _keep(state: LearnState, body: Body, stage: _Stage, step: str) -> LearnState:
    """Update the body if Q does not rise; rounding can raise it."""
    before = state.history[-1][1]
    value = _value(body, state.motion.poses, stage)
    kept = body if value <= before else state.body
    return state._replace(body=kept, history=(*state.history, (stage.prefix + step, min(value, before))))


def _improve_joints(state: LearnState, stage: _Stage, steps: int) -> LearnState:
    middle = None if stage.symmetry is None else middle_directions(state.body, stage.symmetry)
    for _ in range(steps):
        found = improve_joints(
            state.body,
            state.motion.poses,
            stage.meshes.vertices,
            stage.metric,
            stage.curvature,
            state.left_right_pairs,
            state.damping,
            state.history[-1][1],
            given_centres=state.given,
            terms=stage.terms,
            planes=middle,
            close=close_joints(state.body.skeleton),
        )
        state = state._replace(
            body=found.body,
            motion=Motion(found.poses, state.motion.rate),
            damping=found.damping,
            history=(*state.history, (stage.prefix + "joints", found.value)),
        )
    return state
