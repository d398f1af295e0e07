"""Rounds of learning one body from several people: weights of all, and shapes, joints and poses of each."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Int

from ...body.pose import take_poses
from ...compiled import forget_many_compiled
from ...geometry.laplacian import Conformance, make_conformance
from ..anatomy.close_joints import close_joints
from ..objective import objective
from ..skeleton.given_centres import carry_given
from ..skeleton.joints import Curvature, improve_joints, make_curvature
from ..weights.improve_weights import PosedMeshes, improve_shared_weights
from ..weights.rest_vertices import solve_rest_vertices
from .person import Person

_LOG = logging.getLogger(__name__)

#: the most sweeps over the weights in the first round on a mesh, and in later ones
FIRST_SWEEPS, SWEEPS = 8, 4


class MeshMetric(NamedTuple):
    """The metric of Q on one mesh, and the vertices from which its curvature is estimated."""

    metric: Conformance
    curvature: Curvature


def make_mesh_metric(faces: Int[np.ndarray, "T 3"], num_vertices: int, alpha: float) -> MeshMetric:
    """Make the metric of a mesh with the weight `alpha` of the Laplacian term."""
    metric = make_conformance(np.asarray(faces), num_vertices, alpha)
    return MeshMetric(metric, make_curvature(metric))


def total_value(people: Sequence[Person]) -> float:
    """Return Q of all people, squared metres."""
    return float(sum(person.value for person in people))


def evaluate(person: Person, mesh: MeshMetric) -> Person:
    """Evaluate Q of a person."""
    value = float(
        objective(person.body, person.poses, person.targets, mesh.metric, frame_weights=person.frame_weights)
    )
    return person._replace(value=value)


def improve_people(
    people: Sequence[Person], mesh: MeshMetric, pairs: Int[np.ndarray, "P 2"], is_first: bool
) -> list[Person]:
    """Run one round; Q, the sum over all people, never rises.

    The weights are those of all meshes of all people. Each person has rest vertices, joints and poses of its own; the
    orientations of joints stay, as they are those of the shared body.
    """
    forget_many_compiled()
    _LOG.info("weights of %d people", len(people))
    people = improve_weights_of(people, mesh, is_first)
    for number, person in enumerate(people):
        _LOG.info("shape and poses of person %d of %d", number + 1, len(people))
        people[number] = improve_joints_of(improve_rest_of(person, mesh), mesh, pairs)
    return people


def improve_weights_of(people: Sequence[Person], mesh: MeshMetric, is_first: bool) -> list[Person]:
    """Improve the shared skinning weights."""
    skin = improve_shared_weights(
        [_own_meshes(person) for person in people],
        mesh.metric,
        sweeps=FIRST_SWEEPS if is_first else SWEEPS,
        coarse=is_first,
    ).body.skin
    better = [
        evaluate(person._replace(body=eqx.tree_at(lambda b: b.skin, person.body, skin)), mesh)
        for person in people
    ]
    return better if total_value(better) <= total_value(people) else list(people)


def _own_meshes(person: Person) -> PosedMeshes:
    """Take the meshes of a person without repeated ones."""
    rows = np.arange(person.num_meshes)
    return PosedMeshes(person.body, take_poses(person.poses, rows), person.targets[rows])


def improve_rest_of(person: Person, mesh: MeshMetric) -> Person:
    """Improve the rest vertices of a person."""
    rest = solve_rest_vertices(
        person.body, person.poses, person.targets, mesh.metric, frame_weights=person.frame_weights
    )
    body = eqx.tree_at(lambda b: b.vertices, person.body, rest)
    given = carry_given(person.given, person.body, rest)
    better = evaluate(person._replace(body=body, given=given), mesh)
    return better if better.value <= person.value else person


def improve_joints_of(person: Person, mesh: MeshMetric, pairs: Int[np.ndarray, "P 2"]) -> Person:
    """Improve the joint centres and the poses of a person."""
    found = improve_joints(
        person.body,
        person.poses,
        person.targets,
        mesh.metric,
        mesh.curvature,
        pairs,
        person.damping,
        person.value,
        given_centres=person.given,
        free_orientations=False,
        frame_weights=person.frame_weights,
        close=close_joints(person.body.skeleton),
    )
    return person._replace(body=found.body, poses=found.poses, damping=found.damping, value=found.value)
