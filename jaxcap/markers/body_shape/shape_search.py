"""Joint search for the traits of the embedded human and its pose, as outer rounds of one problem.

Traits have kinks at their middle values (MakeHuman's targets are linear between these), so their derivatives
are finite differences over a short range, updated after each step.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ...body.body import Body
from ...body.people.human import shape_from_traits
from ...body.people.morph_targets import AGES, Traits
from ...body.pose import Pose
from ...body.shape_modes import ShapeModes
from ...energy.energy import AbstractEnergy
from ...energy.priors.reference_pose import RestPrior
from ...energy.stacked import NormalPrior
from ...fit.alternate import alternate
from ...fit.sequences.sequence_problem import SequenceEstimate, SequenceProblem
from ...fit.sequences.unknowns import ShapeCoefficients
from ...fit.solvers.levenberg_marquardt import LevenbergMarquardt
from ...geometry.linear import pseudo_inverse

#: ranges of the traits; prior mean and standard deviation of people
MIN_TRAITS = Traits(0.0, AGES["child"], 0.0, 0.0, -1.0)
MAX_TRAITS = Traits(1.0, AGES["old"], 1.0, 1.0, 1.0)
MEAN_TRAITS = Traits(0.5, 35.0, 0.5, 0.5, 0.0)
TRAIT_DEVIATIONS = Traits(0.5, 20.0, 0.25, 0.25, 0.5)
#: share of a trait's range for its finite differences
STEP_FRACTION = 0.02
#: relative decrease of the squared deviations below which a round is idle, and number of idle rounds that
#: end the search
MIN_DECREASE, MAX_IDLE_ROUNDS = 1e-4, 2
#: standard deviations of measured heights and lengths, metres
HEIGHT_DEVIATION, LENGTH_DEVIATION = 0.002, 0.003


class Measurements(NamedTuple):
    """Measurements of the person: lengths between pairs of joints (B, 2), and height, metres."""

    pairs: np.ndarray
    lengths: np.ndarray
    height: float | None


class MeasuredLengths(AbstractEnergy):
    """Differences between measurements of a person and the body, in standard deviations.

    They are the lengths between joints, and the height, which counts where `has_height`.
    """

    pairs: Int[Array, "B 2"]
    lengths: Float[Array, "B"]
    height: Float[Array, ""]
    has_height: Float[Array, ""]

    def residual(self, posed):
        body = posed.body
        ends = body.skeleton.centres[self.pairs]
        distances = jnp.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
        tall = jnp.ptp(body.vertices[:, 1]) - self.height
        return jnp.append(
            (distances - self.lengths) / LENGTH_DEVIATION, self.has_height * tall / HEIGHT_DEVIATION
        )


def search_shape(
    energy: AbstractEnergy | None,
    measurements: Measurements,
    initial_traits: np.ndarray,
    pose: Pose,
    free: tuple[int, ...],
    template: Body,
    resolution: str,
    max_rounds: int,
) -> tuple[np.ndarray, Pose, np.ndarray]:
    """Find the traits, the pose, and the covariance of the free traits."""
    skeleton, dtype, chosen = template.skeleton, template.vertices.dtype, list(free)
    none = RestPrior(jnp.ones((skeleton.num_joints, 3), dtype))
    low, high, usual, spread = (
        jnp.asarray(np.array(x)[chosen], dtype)
        for x in (MIN_TRAITS, MAX_TRAITS, MEAN_TRAITS, TRAIT_DEVIATIONS)
    )
    measure = MeasuredLengths(
        jnp.asarray(measurements.pairs, jnp.int32),
        jnp.asarray(measurements.lengths, dtype),
        jnp.asarray(measurements.height or 0.0, dtype),
        jnp.asarray(0.0 if measurements.height is None else 1.0, dtype),
    )

    def traits(values) -> np.ndarray:
        shifted = initial_traits.copy()
        shifted[chosen] = np.clip(
            np.asarray(values, float), np.array(MIN_TRAITS)[chosen], np.array(MAX_TRAITS)[chosen]
        )
        return shifted

    def remake(y: SequenceEstimate) -> SequenceProblem:
        body, modes = _linearise_shape(template, traits(y.values["traits"]), chosen, resolution)
        return SequenceProblem(
            body,
            none if energy is None else energy,
            jnp.zeros(1, dtype),
            {"traits": ShapeCoefficients(modes, low, high)},
            shared=(measure, NormalPrior("traits", usual, spread)),
        )

    start = SequenceEstimate(
        jax.tree.map(lambda leaf: leaf[None], pose), {"traits": jnp.asarray(initial_traits[chosen], dtype)}
    )
    solver = LevenbergMarquardt(rtol=0.0, atol=0.0, damping=1e-3, relative=True)
    found = alternate(
        remake, start, solver, rounds=max_rounds, min_gain=MIN_DECREASE, patience=MAX_IDLE_ROUNDS
    )
    pose = jax.tree.map(lambda leaf: leaf[0], found.y.poses)
    covariance = pseudo_inverse(np.asarray(_normal_matrix(found.problem, found.y), float), symmetric=True)
    return traits(found.y.values["traits"]), pose, covariance[skeleton.num_dofs :, skeleton.num_dofs :]


@eqx.filter_jit
def _normal_matrix(problem: SequenceProblem, y: SequenceEstimate) -> Float[Array, "N N"]:
    return problem.normal_equations(y)[2].as_matrix()


def _linearise_shape(
    template: Body, traits: np.ndarray, free: list[int], resolution: str
) -> tuple[Body, ShapeModes]:
    """Linearise the body about the given traits: a body and modes with the chosen traits as coefficients.

    The frames of the joints' own angles do not change.
    """
    low, high = np.array(MIN_TRAITS), np.array(MAX_TRAITS)
    vertices, centres = _vertices_and_centres(traits, resolution)
    slopes = []
    for number in free:
        step = STEP_FRACTION * (high - low)[number] * np.eye(len(traits))[number]
        ends = [np.clip(traits + sign * step, low, high) for sign in (-1, 1)]
        difference = (ends[1] - ends[0])[number]
        slopes.append(
            [
                (b - a) / difference
                for a, b in zip(*(_vertices_and_centres(end, resolution) for end in ends), strict=True)
            ]
        )
    by_vertex, by_centre = (np.stack([slope[i] for slope in slopes]) for i in range(2))
    dtype = template.vertices.dtype
    amounts = traits[free]
    vertices = vertices - np.tensordot(amounts, by_vertex, 1)
    centres = centres - np.tensordot(amounts, by_centre, 1)
    arrays = jnp.asarray(vertices, dtype), jnp.asarray(centres, dtype)
    body = eqx.tree_at(lambda b: (b.vertices, b.skeleton.centres), template, arrays)
    return body, ShapeModes(jnp.asarray(by_centre, dtype), jnp.asarray(by_vertex, dtype))


def _vertices_and_centres(traits: np.ndarray, resolution: str) -> tuple[np.ndarray, np.ndarray]:
    vertices, ends = shape_from_traits(Traits(*traits), resolution)
    return vertices, ends[:, 0]
