"""Learn one body with a shape space from registered meshes of several people."""

import logging
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...adapt.shape.joint_regressor import make_joint_regressor
from ...arguments import checked
from ...body.body import Body, take_vertices
from ...body.body_model import BodyModel
from ...body.pose import Motion, take_poses
from ...body.skeleton import Skeleton
from ...body.skin import AbstractSkin
from ...errors import InputError
from ...fit.precision import with_precision
from ...observe.meshes import MeshSequence
from ...value_checks import check_at_least
from ..anatomy.choose_skeleton import SkeletonName, choose_skeleton
from ..anatomy.find_person import PlacedPerson
from ..decimated_meshes import DecimatedMeshes, coarse_alpha, decimate_meshes, num_coarse_vertices
from ..full_resolution import interpolate_skin
from ..initialise import SkinName
from ..learn_body import COARSE_PREFIX, COARSE_SHARE, FIRST_DAMPING, FIRST_STEPS, MIN_DECREASE, learn_body
from ..skeleton.given_centres import GivenCentres
from ..weights.rest_vertices import fit_rest_vertices
from .check_people import check_people, find_moving
from .initialise_person import Reference, initialise_person
from .person import Person, repeat_meshes, repeated_rows
from .rest_alignment import align_rest_poses, check_rest_alignment
from .rounds import (
    MeshMetric,
    evaluate,
    improve_joints_of,
    improve_people,
    make_mesh_metric,
    total_value,
)
from .shape_space import make_shape_space, refit_poses

_LOG = logging.getLogger(__name__)

#: the most rounds of the body of the first person, with which learning begins
REFERENCE_ROUNDS = 8
#: the end of the name of the first step of a stage in the history
START = "start"
#: the most people in whose meshes a person's skeleton is placed
MAX_TRIED = 3


class PeopleState(NamedTuple):
    """The state of learning from several people after a round: with their meshes sufficient to resume."""

    people: tuple[Person, ...]
    #: pairs of left and right joints whose bones stay equally long
    left_right_pairs: Int[np.ndarray, "P 2"]
    #: learning began with the joints of a given skeleton or of anatomy
    has_given_joints: bool
    #: (step, Q), Q in squared metres, the sum over all people
    history: tuple[tuple[str, float], ...] = ()
    round: int = 0
    #: whether left and right of the first person's surface were found; "" if not searched for, or if the state was read
    symmetry_message: str = ""


class LearnedPeople(NamedTuple):
    """One body of several people with its shape space, and each person's coefficients and poses."""

    model: BodyModel
    #: in the order of the rows of `coefficients`
    names: tuple[str, ...]
    coefficients: Float[np.ndarray, "N K"]
    #: the poses of each person's meshes, of the body of the coefficients
    motions: tuple[Motion, ...]
    #: share of each component in the variance of joints and vertices at rest
    explained: Float[np.ndarray, "K"]
    #: pairs of left and right joints
    left_right_pairs: Int[np.ndarray, "P 2"]
    #: (step, Q) after every round, Q in squared metres; it never rises between a "start" and the next one
    history: tuple[tuple[str, float], ...]
    #: where learning began with the joints of the mean shape; None if they were found from the motion
    given: GivenCentres | None = None
    #: whether left and right of the surface were found; "" if not searched for, or if the run was resumed
    symmetry_message: str = ""


@checked
def learn_people(
    people: Mapping[str, MeshSequence],
    *,
    components: int | None = None,
    joints: int | None = None,
    skin: SkinName = "swing_twist",
    alpha: float = 100.0,
    symmetry: bool | Int[np.ndarray, "P 2"] = True,
    skeleton: Skeleton | SkeletonName = "automatic",
    fix_joints: bool = False,
    rounds: int = 30,
    on_round: Callable[[PeopleState], None] | None = None,
    resume: PeopleState | None = None,
) -> LearnedPeople:
    """Learn one skeleton, one set of skinning weights and a shape space from registered meshes of several people.

    A body is first learned from the person with the most meshes (`learn_body`), and given the shape of every other person
    (`initialise_person`). Rounds then lower

        Q = sum_p sum_m |x_pm - T(v_p, c_p, q_pm; w)|^2 + alpha |L(x_pm - T(...))|^2

    where the weights `w` are those of all people, and rest vertices `v_p`, joint centres `c_p` and poses `q_pm` those of each. All
    people have one rest pose. The shape space is that of the principal components of rest vertices and joints together, so that
    joints are a linear function of the shape coefficients, as in SMPL (Loper et al. 2015), which regresses them from vertices.

    **Arguments:** `people`, the meshes of each person by name, in one topology. A person may have a single mesh, whose joints are
    then estimated from the surface, if another one has several. `components`, the number of coefficients, at most one less than
    people, which is the default. `resume` continues from a state after a round, with the same result; the first body and its skeleton
    are then those of the state. The others as of `learn_body`; a `Skeleton` is in the pose of the first mesh of the first person.

    **Raises:** `ValueError` and `InputError` with one sentence as `learn_body` does, and `InputError` as `check_people` does, and for
    a state of other people.
    """
    check_at_least(
        "learn_people", 1, rounds=rounds, **({} if components is None else {"components": components})
    )
    for message in check_people(people):
        _LOG.warning(message)
    names, sequences = tuple(people), with_precision(list(people.values()), jnp.result_type(float))
    if resume is None:
        state = _start(sequences, names, joints, skin, alpha, symmetry, skeleton, fix_joints, rounds)
    else:
        _check_state(resume, people)
        state = resume
    for message in check_rest_alignment(state.people[0].body.skeleton):
        _LOG.warning(message)
    found = _improve_all(state, sequences, alpha, joints, rounds, on_round)
    space = make_shape_space([person.body for person in found.people], components)
    motions = tuple(
        Motion(take_poses(person.poses, np.arange(len(sequence))), sequence.rate)
        for person, sequence in zip(found.people, sequences, strict=True)
    )
    if components is not None and components < len(people) - 1:
        _LOG.info("fitting the poses to the people of %d coefficients", components)
        motions = refit_poses(space, motions, sequences)
    return LearnedPeople(
        space.model,
        names,
        space.coefficients,
        motions,
        space.explained,
        found.left_right_pairs,
        found.history,
        _mean_given(found.people) if found.has_given_joints else None,
        found.symmetry_message,
    )


def _start(
    sequences: Sequence[MeshSequence],
    names: Sequence[str],
    joints: int | None,
    skin: SkinName,
    alpha: float,
    symmetry: bool | np.ndarray,
    skeleton: Skeleton | SkeletonName,
    fix_joints: bool,
    rounds: int,
) -> PeopleState:
    """Learn a body from one person, and give it the shape of all others."""
    moving = find_moving(sequences)
    first, start = _choose_reference(sequences, moving, skeleton, joints, symmetry, names)
    _LOG.info("learning a first body from %d meshes of %s", len(sequences[first]), names[first])
    learned = learn_body(
        sequences[first],
        joints=joints,
        skin=skin,
        alpha=alpha,
        symmetry=symmetry,
        skeleton="none" if start is None else start,
        fix_joints=fix_joints,
        rounds=min(rounds, REFERENCE_ROUNDS),
    )
    pairs, given = learned.left_right_pairs, _reference_centres(learned, fix_joints)
    reference = Reference(learned.body, make_joint_regressor(learned.body), pairs, given, FIRST_DAMPING)
    people: list[Person] = []
    for number, sequence in enumerate(sequences):
        if number == first:
            people.append(Person(learned.body, learned.motion.poses, sequence.vertices, given, FIRST_DAMPING))
            continue
        _LOG.info("giving the body the shape of %s", names[number])
        people.append(initialise_person(reference, sequence.vertices))
    return PeopleState(
        tuple(repeat_meshes(person) for person in people),
        np.asarray(pairs),
        learned.given is not None,
        symmetry_message=learned.symmetry_message,
    )


def _check_state(state: PeopleState, people: Mapping[str, MeshSequence]) -> None:
    """Check that a state is one of these people. Raises `InputError`."""
    here = [len(repeated_rows(len(sequence))) for sequence in people.values()]
    there = [len(person.poses.rotations) for person in state.people]
    if here != there:
        raise InputError(
            f"learn_people: `resume` has {len(there)} people with {', '.join(map(str, there))} meshes with repeated ones, but the "
            f"meshes given are those of {len(here)} people with {', '.join(map(str, here))}; give the meshes with which the run began."
        )


def _choose_reference(
    people: Sequence[MeshSequence],
    moving: Sequence[int],
    skeleton: Skeleton | SkeletonName,
    joints: int | None,
    symmetry: bool | np.ndarray,
    names: Sequence[str],
) -> tuple[int, Skeleton | PlacedPerson | None]:
    """Choose the person with whom learning begins, and its skeleton; None for a free search.

    It is the person with the most meshes among those who move, or of the three with the most the first one in whose meshes a
    person is recognised.
    """
    if isinstance(skeleton, Skeleton):
        if 0 not in moving:
            raise InputError(
                f"The skeleton is that of the first person, and the meshes of {names[0]} show no motion; give a person with several "
                f"poses first, such as {names[moving[0]]}, with the skeleton in that person's first mesh."
            )
        return 0, skeleton
    order = sorted(moving, key=lambda number: -len(people[number]))
    free = joints is not None or not isinstance(symmetry, bool)
    if skeleton == "none" or (skeleton == "automatic" and free):
        return order[0], None
    if joints is not None:
        raise ValueError("The human skeleton has its own joints; omit `joints`.")
    several = order[:MAX_TRIED]
    for number in several:
        placed, sentence = choose_skeleton(
            people[number], "automatic", _mesh_names(names[number], people[number])
        )
        if placed is not None:
            _LOG.info(sentence)
            return number, placed
    if skeleton == "human":
        raise InputError(
            f"The human skeleton cannot be placed in the meshes of {', '.join(names[number] for number in several)}: "
            f"{sentence.partition(', as ')[2]}; give a mesh of one of them upright, with the arms away from the body, or search for "
            "joints freely (`--skeleton none`)."
        )
    _LOG.info(sentence)
    return order[0], None


def _mesh_names(name: str, meshes: MeshSequence) -> list[str]:
    return [f"mesh {number} of {name}" for number in range(len(meshes))]


def _reference_centres(learned, fix_joints: bool) -> GivenCentres:
    """Return the joints of the first person, and the planes of those on the middle, as a prior."""
    if learned.given is None:
        return GivenCentres(learned.body.skeleton.centres, fix_joints)
    return GivenCentres(learned.body.skeleton.centres, fix_joints, learned.given.normals)


def _improve_all(
    state: PeopleState,
    sequences: Sequence[MeshSequence],
    alpha: float,
    joints: int | None,
    rounds: int,
    on_round: Callable[[PeopleState], None] | None,
) -> PeopleState:
    """Run rounds on a subset of the vertices, if there are many, align the rest poses, and run rounds on all.

    The history shows which of both stages a state to resume from is in.
    """
    faces = np.asarray(sequences[0].faces)
    everything = MeshSequence(jnp.concatenate([s.vertices[:1] for s in sequences]), faces)
    coarse = decimate_meshes(everything, num_coarse_vertices(joints))
    count, kept = len(coarse.nearest), len(coarse.kept)
    thin = make_mesh_metric(np.asarray(coarse.meshes.faces), kept, coarse_alpha(alpha, count, kept))
    prefix = COARSE_PREFIX if kept < count else ""
    stage = sum(step.endswith(START) for step, _ in state.history)
    if stage > 0:
        given = zip(state.people, sequences, strict=True)
        state = state._replace(people=tuple(_with_targets(*each, coarse) for each in given))
    if stage < 2:
        if stage == 0:
            state = state._replace(people=tuple(_take_kept(person, coarse) for person in state.people))
            state = _begin_stage(state, thin, prefix)
        state = _improve(state, thin, round(COARSE_SHARE * rounds), on_round, prefix)
        if kept < count:
            _LOG.info("transferring the body to all vertices")
            # all people have the same weights
            skin = interpolate_skin(state.people[0].body, coarse, np.asarray(sequences[0].vertices[0], float))
            grown = [_give_all(*each, skin) for each in zip(state.people, sequences, strict=True)]
            state = state._replace(people=tuple(grown))
        state = state._replace(people=tuple(align_rest_poses(state.people)))
    fine = thin if kept == count else make_mesh_metric(faces, count, alpha)
    if stage < 2:
        state = _begin_stage(state, fine, "")
    return _improve(state, fine, rounds, on_round, "")


def _begin_stage(state: PeopleState, mesh: MeshMetric, prefix: str) -> PeopleState:
    """Evaluate Q on a mesh; at the beginning of all, improve joints and poses first."""
    people = [evaluate(person, mesh) for person in state.people]
    for _ in range(FIRST_STEPS if state.round == 0 else 0):
        people = [improve_joints_of(person, mesh, state.left_right_pairs) for person in people]
    history = (*state.history, (prefix + START, total_value(people)))
    return state._replace(people=tuple(people), history=history)


def _improve(
    state: PeopleState,
    mesh: MeshMetric,
    rounds: int,
    on_round: Callable[[PeopleState], None] | None,
    prefix: str,
) -> PeopleState:
    """Run rounds on one mesh until one lowers Q by little, or until the most rounds are reached."""
    while state.round < rounds:
        values = _stage_values(state)
        # the first round on a mesh is followed by another one
        if len(values) > 2 and values[-1] > (1 - MIN_DECREASE) * values[-2]:
            break
        people = improve_people(state.people, mesh, state.left_right_pairs, len(values) == 1)
        history = (*state.history, (prefix + "round", total_value(people)))
        state = state._replace(people=tuple(people), history=history, round=state.round + 1)
        if on_round is not None:
            on_round(state)
    return state


def _stage_values(state: PeopleState) -> list[float]:
    """Return Q at the start of the stage and after each of its rounds."""
    last = max(number for number, (step, _) in enumerate(state.history) if step.endswith(START))
    return [value for _, value in state.history[last:]]


def _take_kept(person: Person, coarse: DecimatedMeshes) -> Person:
    """Restrict a person to the kept vertices."""
    kept = jnp.asarray(coarse.kept)
    body = take_vertices(person.body, kept, coarse.meshes.faces)
    return person._replace(body=body, targets=person.targets[:, kept])


def _with_targets(person: Person, sequence: MeshSequence, coarse: DecimatedMeshes) -> Person:
    """Give a person of a state the meshes again, with the vertices of its body."""
    targets = sequence.vertices[repeated_rows(len(sequence))]
    whole = len(person.body.vertices) == len(coarse.nearest)
    return person._replace(targets=targets if whole else targets[:, jnp.asarray(coarse.kept)])


def _give_all(person: Person, sequence: MeshSequence, skin: AbstractSkin) -> Person:
    """Give a person all vertices: with the weights of all people, and each in its best position at rest."""
    body = Body(person.body.skeleton, skin, sequence.vertices[0], sequence.faces)
    targets = sequence.vertices[repeated_rows(len(sequence))]
    rest = fit_rest_vertices(body, person.poses, targets, person.frame_weights)
    return person._replace(body=eqx.tree_at(lambda b: b.vertices, body, rest), targets=targets)


def _mean_given(people: Sequence[Person]) -> GivenCentres:
    """Return the mean of the positions that the surfaces give to the joints."""
    centres: Float[Array, "J 3"] = jnp.mean(jnp.stack([person.given.centres for person in people]), 0)
    return people[0].given._replace(centres=centres)
