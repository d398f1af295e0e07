"""Energies: additive weighted residuals of a posed body."""

import abc
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..arguments import check_fields, checked
from ..body.body import Posed


class AbstractEnergy(eqx.Module):
    """A squared residual `E = |r|^2` of a posed body (Kineben, eq. 2).

    A new energy is a class with its data as fields and one method. It adds to others (`a + b`) and is
    weighted by a number (`3.0 * a`, which triples `E`).
    """

    #: an array of NumPy times an energy is refused here, and not multiplied element by element
    __array_ufunc__ = None

    def __check_init__(self):
        check_fields(self)

    @abc.abstractmethod
    def residual(self, posed: Posed) -> Float[Array, "R"]:
        """Compute the residual of one posed body, any number of components."""

    def __add__(self, other: "AbstractEnergy") -> "Sum":
        return Sum(terms_of(self) + terms_of(other))

    def __radd__(self, other) -> "AbstractEnergy":
        # the start value of `sum`
        if other == 0:
            return self
        return NotImplemented

    def __mul__(self, weight) -> "AbstractEnergy":
        return weighted(weight, self)

    def __rmul__(self, weight) -> "AbstractEnergy":
        return weighted(weight, self)


class Weighted(AbstractEnergy):
    """`weight * E` of another energy; the weight is at least zero."""

    energy: AbstractEnergy
    weight: Float[Array, ""]

    def residual(self, posed):
        return safe_sqrt(self.weight) * self.energy.residual(posed)


class Sum(AbstractEnergy):
    """The sum of several energies: their concatenated residuals."""

    terms: tuple[AbstractEnergy, ...]

    def residual(self, posed):
        return jnp.concatenate([term.residual(posed) for term in self.terms])


def weighted(weight, energy: AbstractEnergy) -> AbstractEnergy:
    """Weight an energy, `weight * E`; a sum is weighted term by term, and nested weights multiply."""
    if isinstance(energy, Sum):
        return Sum(tuple(weighted(weight, term) for term in energy.terms))
    if isinstance(energy, Weighted):
        return Weighted(energy.energy, _as_array(weight * energy.weight))
    return Weighted(energy, _as_array(weight))


def _as_array(weight) -> Float[Array, ""]:
    """Convert a weight to an array, in its own precision if it is one already."""
    there = eqx.is_inexact_array(weight)
    return weight if there else jnp.asarray(weight, float)


def sum_energies(energies: Sequence[AbstractEnergy | None]) -> AbstractEnergy | None:
    """Add up energies without nesting sums; None where there are none."""
    terms = tuple(term for energy in energies if energy is not None for term in terms_of(energy))
    return Sum(terms) if terms else None


def terms_of(energy: AbstractEnergy) -> tuple[AbstractEnergy, ...]:
    """Get the terms of an energy; the energy itself if it is no sum."""
    return energy.terms if isinstance(energy, Sum) else (energy,)


def energy_name(energy: AbstractEnergy) -> str:
    """Get the class name of an energy without its weight: `JointLimits`."""
    return type(unweighted(energy)).__name__


def unweighted(energy: AbstractEnergy) -> AbstractEnergy:
    """Strip the weight from an energy."""
    return unweighted(energy.energy) if isinstance(energy, Weighted) else energy


@checked
def energies(energy: AbstractEnergy, posed: Posed) -> dict[str, Float[Array, ""]]:
    """Compute the value `|r|^2` of every term by its name; equal names are added up."""
    values: dict[str, Float[Array, ""]] = {}
    for term in terms_of(energy):
        r = term.residual(posed)
        values[energy_name(term)] = values.get(energy_name(term), jnp.zeros((), r.dtype)) + jnp.sum(r * r)
    return values


def safe_sqrt(weights: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Compute the square root of weights, with slope zero where a weight is zero, so that missing data stay
    without effect under differentiation.
    """
    positive = weights > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, weights, 1.0)), 0.0)


def mask_unweighted(weights: Float[Array, "C"], rows: Float[Array, "C 3"]) -> Float[Array, "C 3"]:
    """Replace rows of weight zero by zeros, because unobserved data may be NaN."""
    return jnp.where((weights > 0)[:, None], rows, 0.0)
