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
from ...body.body import take_vertices
from ...body.body_model import BodyModel
from ...body.pose import Motion, take_poses
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...observe.meshes import MeshSequence
from ...value_checks import check_at_least
from ..anatomy.choose_skeleton import SkeletonName, choose_skeleton
from ..anatomy.find_person import PlacedPerson
from ..decimated_meshes import DecimatedMeshes, coarse_alpha, decimate_meshes, num_coarse_vertices
from ..initialise import SkinName
from ..learn_body import COARSE_PREFIX, COARSE_SHARE, FIRST_DAMPING, FIRST_STEPS, MIN_DECREASE, learn_body
from ..skeleton.joint_centre_prior import GivenCentres
from ..weights.rest_vertices import fit_rest_vertices
from .check_people import check_people, find_moving
from .person import Person, initialise_person, repeat_meshes, repeated_rows
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
#: the most people in whose meshes a person's skeleton is placed
MAX_TRIED = 3


class PeopleState(NamedTuple):
    """The state of learning from several people after a round."""

    people: tuple[Person, ...]
    #: (step, Q), Q in squared metres, the sum over all people
    history: tuple[tuple[str, float], ...]
    round: int


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
) -> LearnedPeople:
    """Learn one skeleton, one set of skinning weights and a shape space from registered meshes of several people.

    A body is first learned from the person with the most meshes (`learn_body`), and given the shape of every other person
    (`initialise_person`). Rounds then lower

        Q = sum_p sum_m |x_pm - T(v_p, c_p, q_pm; w)|^2 + alpha |L(x_pm - T(...))|^2

    where the weights `w` are those of all people, and rest vertices `v_p`, joint centres `c_p` and poses `q_pm` those of each. All
    people have one rest pose. The shape space is that of the principal components of rest vertices and joints together, so that
    joints are a linear function of the shape coefficients, as in SMPL (Loper et al. 2015), which regresses them from vertices.

    **Arguments:** `people`, the meshes of each person by name, in one topology. A person may have a single mesh, whose joints are
    then those of the surface, if another one has several. `components`, the number of coefficients, at most one less than
    people, which is the default. The others as of `learn_body`; a `Skeleton` is in the pose of the first mesh of the first person.

    **Raises:** `ValueError` and `InputError` with one sentence as `learn_body` does, and `InputError` as `check_people` does.
    """
    check_at_least(
        "learn_people", 1, rounds=rounds, **({} if components is None else {"components": components})
    )
    for message in check_people(people):
        _LOG.warning(message)
    moving = find_moving(list(people.values()))
    names, sequences = tuple(people), list(people.values())
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
    for message in check_rest_alignment(learned.body.skeleton):
        _LOG.warning(message)
    pairs, given = learned.left_right_pairs, _reference_centres(learned, fix_joints)
    regressor = make_joint_regressor(learned.body)
    state: list[Person] = []
    for number, sequence in enumerate(sequences):
        if number == first:
            state.append(Person(learned.body, learned.motion.poses, sequence.vertices, given, FIRST_DAMPING))
            continue
        _LOG.info("giving the body the shape of %s", names[number])
        state.append(
            initialise_person(learned.body, regressor, sequence.vertices, pairs, given, FIRST_DAMPING)
        )
    repeated = tuple(repeat_meshes(person) for person in state)
    found = _improve_all(PeopleState(repeated, (), 0), sequences, alpha, pairs, joints, rounds, on_round)
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
        pairs,
        found.history,
        None if learned.given is None else _mean_given(found.people),
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
    pairs: Int[np.ndarray, "P 2"],
    joints: int | None,
    rounds: int,
    on_round: Callable[[PeopleState], None] | None,
) -> PeopleState:
    """Run rounds on a subset of the vertices, if there are many, align the rest poses, and run rounds on all."""
    faces = np.asarray(sequences[0].faces)
    everything = MeshSequence(jnp.concatenate([s.vertices[:1] for s in sequences]), faces)
    coarse = decimate_meshes(everything, num_coarse_vertices(joints))
    count, kept = len(coarse.nearest), len(coarse.kept)
    thin = make_mesh_metric(np.asarray(coarse.meshes.faces), kept, coarse_alpha(alpha, count, kept))
    state = state._replace(people=tuple(_take_kept(person, coarse) for person in state.people))
    prefix = COARSE_PREFIX if kept < count else ""
    state = _improve(state, thin, pairs, round(COARSE_SHARE * rounds), on_round, prefix)
    if kept < count:
        _LOG.info("transferring the body to all vertices")
        grown = [_give_all(*each, coarse) for each in zip(state.people, sequences, strict=True)]
        state = state._replace(people=tuple(grown))
    state = state._replace(people=tuple(align_rest_poses(state.people)))
    fine = thin if kept == count else make_mesh_metric(faces, count, alpha)
    return _improve(state, fine, pairs, rounds, on_round, "")


def _improve(
    state: PeopleState,
    mesh: MeshMetric,
    pairs: Int[np.ndarray, "P 2"],
    rounds: int,
    on_round: Callable[[PeopleState], None] | None,
    prefix: str,
) -> PeopleState:
    """Run rounds on one mesh until one lowers Q by little, or until the most rounds are reached."""
    people = [evaluate(person, mesh) for person in state.people]
    for _ in range(FIRST_STEPS if state.round == 0 else 0):
        people = [improve_joints_of(person, mesh, pairs) for person in people]
    state = PeopleState(tuple(people), (*state.history, (prefix + "start", total_value(people))), state.round)
    is_first = True
    while state.round < rounds:
        before = total_value(state.people)
        people = improve_people(state.people, mesh, pairs, is_first)
        value = total_value(people)
        state = PeopleState(tuple(people), (*state.history, (prefix + "round", value)), state.round + 1)
        if on_round is not None:
            on_round(state)
        if not is_first and value > (1 - MIN_DECREASE) * before:
            break
        is_first = False
    return state


def _take_kept(person: Person, coarse: DecimatedMeshes) -> Person:
    """Restrict a person to the kept vertices."""
    kept = jnp.asarray(coarse.kept)
    body = take_vertices(person.body, kept, coarse.meshes.faces)
    return person._replace(body=body, targets=person.targets[:, kept])


def _give_all(person: Person, sequence: MeshSequence, coarse: DecimatedMeshes) -> Person:
    """Give a person all vertices: each with the weights of the nearest kept one, and its best position at rest."""
    body = take_vertices(person.body, jnp.asarray(coarse.nearest), sequence.faces)
    targets = sequence.vertices[repeated_rows(len(sequence))]
    rest = fit_rest_vertices(body, person.poses, targets, person.frame_weights)
    return person._replace(body=eqx.tree_at(lambda b: b.vertices, body, rest), targets=targets)


def _mean_given(people: Sequence[Person]) -> GivenCentres:
    """Return the mean of the positions that the surfaces give to the joints."""
    centres: Float[Array, "J 3"] = jnp.mean(jnp.stack([person.given.centres for person in people]), 0)
    return people[0].given._replace(centres=centres)
