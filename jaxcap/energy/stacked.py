"""Energies of a sequence: those with data of each frame, and those between neighbouring frames."""

import abc
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import check_fields, checked
from ..body.body import Posed
from ..errors import InputError
from ..stacking import stack
from .energy import AbstractEnergy, Sum, Weighted, energy_name, safe_sqrt, terms_of, weighted
from .priors.temporal import second_difference


class Stacked(AbstractEnergy):
    """One energy with separate data for each of F frames: all arrays of `energy` have a leading axis of
    frames.

    Made by `stack_energies`. In a sum with it, any other energy is the same in every frame.
    """

    energy: AbstractEnergy

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        raise InputError(
            f"Stacked: the data of {energy_name(self.energy)} belong to several frames, but there is one posed body; "
            "solve for the sequence with a SequenceProblem."
        )


@checked
def stack_energies(energies: Sequence[AbstractEnergy]) -> Stacked:
    """Stack the energies of single frames, which have one type and one shape.

    **Raises:** `InputError` where there are none, and where they differ in type or shape.
    """
    if not energies:
        raise InputError("stack_energies: `energies` is empty; expected one energy for each frame.")
    kinds = [jax.tree.structure(energy) for energy in energies]
    shapes = [[jnp.shape(leaf) for leaf in jax.tree.leaves(energy)] for energy in energies]
    for frame in range(1, len(energies)):
        if (kinds[frame], shapes[frame]) != (kinds[0], shapes[0]):
            raise InputError(
                f"stack_energies: the energy of frame {frame}, {energy_name(energies[frame])} with arrays of shapes "
                f"{shapes[frame]}, differs from that of frame 0, {energy_name(energies[0])} with {shapes[0]}; pad missing "
                "data with weights of zero."
            )
    return Stacked(jax.tree.map(lambda *leaves: stack([jnp.asarray(leaf) for leaf in leaves]), *energies))


class FrameWeighted(AbstractEnergy):
    """One energy that is the same in every frame, with a weight for each of F frames (`weight_frames`)."""

    energy: AbstractEnergy
    weights: Float[Array, "F"]

    def residual(self, posed: Posed) -> Float[Array, "R"]:
        raise InputError(
            f"FrameWeighted: the weights of {energy_name(self.energy)} belong to {len(self.weights)} frames, but there "
            "is one posed body; solve for the sequence with a SequenceProblem."
        )


@checked
def weight_frames(weights: Float[Array, "F"], energy: AbstractEnergy) -> AbstractEnergy:
    """Weight an energy by a number for each frame; a sum is weighted term by term."""
    if isinstance(energy, Sum):
        return Sum(tuple(weight_frames(weights, term) for term in energy.terms))
    return FrameWeighted(energy, weights)


class AbstractSharedEnergy(eqx.Module):
    """A squared residual of the values shared by all frames of a sequence, and of their body."""

    def __check_init__(self):
        check_fields(self)

    @abc.abstractmethod
    def residual(self, values: dict[str, Any], posed: Posed) -> Float[Array, "R"]:
        """Compute the residual of shared values by their names, and of their body at rest."""


class NormalPrior(AbstractSharedEnergy):
    """A normal distribution of one shared value: deviation of each component from its expected value, in
    standard deviations.
    """

    name: str = eqx.field(static=True)
    expected: Float[Array, "N"]
    deviations: Float[Array, "N"]

    def residual(self, values, posed):
        return (values[self.name].reshape(-1) - self.expected) / self.deviations


class AbstractNeighbourEnergy(eqx.Module):
    """A squared residual of a few successive frames, such as for smooth motion."""

    def __check_init__(self):
        check_fields(self)

    @property
    @abc.abstractmethod
    def frames(self) -> int:
        """The number of successive frames in the residual, two or more."""

    @abc.abstractmethod
    def residual(self, posed: tuple[Posed, ...], gaps: Float[Array, "W"]) -> Float[Array, "R"]:
        """Compute the residual of successive posed bodies, `gaps` frames apart: one gap less than there are
        bodies.
        """


class SmoothRotations(AbstractNeighbourEnergy):
    """Deviation of all joints' rotations from the midpoint of the previous and the next: the mean over joints
    of squares, radians squared, times a weight (Adaptation, eqs. 4.9 and 4.10).
    """

    weight: Float[Array, ""]

    @property
    def frames(self):
        return 3

    def residual(self, posed, gaps):
        turns = [one.pose.rotations for one in posed]
        differences = second_difference(turns[0], turns[1], turns[2], gaps[0], gaps[1])
        return (
            safe_sqrt(self.weight)
            * differences.reshape(-1)
            / jnp.sqrt(jnp.asarray(len(differences), differences.dtype))
        )


def split_frames(energy: AbstractEnergy) -> tuple[AbstractEnergy, AbstractEnergy]:
    """Split an energy into the arrays of each frame, with `None` elsewhere, and the rest."""

    def own(node: Any) -> Any:
        if isinstance(node, FrameWeighted):
            inner = jax.tree.map(own, node.energy, is_leaf=_is_framewise)
            return eqx.tree_at(lambda n: (n.energy, n.weights), node, (inner, True))
        return jax.tree.map(eqx.is_array, node) if isinstance(node, Stacked) else False

    return eqx.partition(energy, jax.tree.map(own, energy, is_leaf=_is_framewise))


def join_frame(frame_part: AbstractEnergy, shared_part: AbstractEnergy) -> AbstractEnergy:
    """Combine the arrays of one frame with the rest to its energy, a flat sum."""
    return Sum(_flatten_terms(eqx.combine(frame_part, shared_part)))


def frame_counts(energy: AbstractEnergy) -> set[int]:
    """Find the frame counts of the stacked terms of an energy."""
    return {leaf.shape[0] for leaf in jax.tree.leaves(split_frames(energy)[0])}


def _is_framewise(node: Any) -> bool:
    return isinstance(node, Stacked | FrameWeighted)


def _flatten_terms(energy: AbstractEnergy) -> tuple[AbstractEnergy, ...]:
    if isinstance(energy, Sum):
        return sum((_flatten_terms(term) for term in energy.terms), ())
    if isinstance(energy, Weighted):
        return terms_of(weighted(energy.weight, Sum(_flatten_terms(energy.energy))))
    if isinstance(energy, FrameWeighted):
        return terms_of(weighted(energy.weights, Sum(_flatten_terms(energy.energy))))
    return _flatten_terms(energy.energy) if isinstance(energy, Stacked) else (energy,)
