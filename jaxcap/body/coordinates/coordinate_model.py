"""Skeletons that are moved by generalised coordinates, as in biomechanics (Delp et al. 2007, OpenSim)."""

from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import check_fields, check_length, checked
from ...errors import InputError
from ...geometry import rotation
from ..pose import Motion, Pose
from ..skeleton import Skeleton
from .piecewise_polynomial import PiecewisePolynomials, evaluate_polynomials


class Coordinate(NamedTuple):
    """A generalised coordinate of a model."""

    name: str
    #: true for an angle of rotation in radians; false for a length in metres, and for a coordinate that only functions use
    is_angle: bool
    #: true if the range bounds the coordinate
    is_clamped: bool
    #: true if the coordinate keeps its default value
    is_locked: bool
    #: index of the coordinate that determines this one; -1 for none
    leader: int = -1
    #: true if a whole turn more is the same pose
    is_periodic: bool = False

    @property
    def is_free(self) -> bool:
        """True if a solver may change the coordinate."""
        return not self.is_locked and self.leader < 0


class CoordinateModel(eqx.Module):
    """A skeleton whose joints are moved by Q generalised coordinates.

    Each joint rotates about three axes, one after another, and translates along three more. Each of these six amounts is a
    function of one coordinate, so that one angle may turn a knee and shift its centre (a spatial transform of OpenSim; Seth
    et al. 2010). A coordinate may itself be a function of another one, as the angle of a patella. The skeleton is at rest at the
    default values.
    """

    skeleton: Skeleton
    #: three axes of rotation and three of translation of each joint, in the world at rest
    axes: Float[Array, "J 6 3"]
    #: amounts about and along these axes, radians and metres
    amounts: PiecewisePolynomials
    #: values of coordinates that are functions of others
    followers: PiecewisePolynomials
    #: values at rest, and ranges, radians and metres
    defaults: Float[Array, "Q"]
    low: Float[Array, "Q"]
    high: Float[Array, "Q"]
    coordinates: tuple[Coordinate, ...] = eqx.field(static=True)
    #: the coordinate of each amount; -1 for a constant one
    drivers: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    def __check_init__(self):
        lengths = check_fields(self)
        check_length(self, "drivers", len(self.drivers), lengths, "J")
        check_length(self, "coordinates", len(self.coordinates), lengths, "Q")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates, in the order of their values."""
        return tuple(coordinate.name for coordinate in self.coordinates)

    @property
    def free(self) -> np.ndarray:
        """Indices of the coordinates that a solver may change."""
        return np.flatnonzero([coordinate.is_free for coordinate in self.coordinates])

    @property
    def bounds(self) -> tuple[Float[Array, "Q"], Float[Array, "Q"]]:
        """Lowest and highest values of all coordinates; infinite for those that are not clamped."""
        clamped = np.array([coordinate.is_clamped for coordinate in self.coordinates])
        return jnp.where(clamped, self.low, -jnp.inf), jnp.where(clamped, self.high, jnp.inf)

    def index(self, name: str) -> int:
        """Return the index of a coordinate. Raises `KeyError` with the existing names."""
        if name not in self.names:
            raise KeyError(f"There is no coordinate '{name}'; the model has {', '.join(self.names)}.")
        return self.names.index(name)


class CoordinateTargets(eqx.Module):
    """Values near which coordinates stay, with the energy `sum_q w_q (y_q - value_q)^2`."""

    #: radians and metres
    values: Float[Array, "Q"]
    #: zero for coordinates without a target
    weights: Float[Array, "Q"]

    def __check_init__(self):
        check_fields(self)


@checked
@partial(jax.jit, inline=True)
def pose_from_coordinates(model: CoordinateModel, values: Float[Array, "Q"]) -> Pose:
    """Compute the pose of given coordinates, radians and metres; those of coordinates that follow others are not used."""
    dtype = model.axes.dtype
    now = _spatial_transforms(model, values.astype(dtype))
    rest = _spatial_transforms(model, model.defaults)
    rotations = rotation.multiply(now[0], rotation.conjugate(rest[0]))
    return Pose(now[1] - rest[1], rotation.normalise(rotations), jnp.ones((), dtype))


@checked
def motion_from_coordinates(
    model: CoordinateModel, values: Float[np.ndarray | Array, "F Q"], rate: float
) -> Motion:
    """Compute the motion of coordinates over frames; raises `InputError` where there are no frames."""
    if not len(values):
        raise InputError("motion_from_coordinates: `values` has no frames; expected at least one.")
    return Motion(_poses(model, jnp.asarray(values, model.axes.dtype)), rate)


@eqx.filter_jit
def _poses(model: CoordinateModel, values: Float[Array, "F Q"]) -> Pose:
    return jax.lax.map(partial(pose_from_coordinates, model), values)


def follow_leaders(model: CoordinateModel, values: Float[Array, "Q"]) -> Float[Array, "Q"]:
    """Replace the values of coordinates that are functions of others."""
    leaders = np.array([coordinate.leader for coordinate in model.coordinates])
    if (leaders < 0).all():
        return values
    return jnp.where(
        leaders < 0, values, evaluate_polynomials(model.followers, values[np.maximum(leaders, 0)])
    )


def _spatial_transforms(
    model: CoordinateModel, values: Float[Array, "Q"]
) -> tuple[Float[Array, "J 4"], Float[Array, "J 3"]]:
    """Compute rotation and translation of each joint's own transform, in the axes of the world at rest."""
    values = follow_leaders(model, values)
    amounts = evaluate_polynomials(model.amounts, values[np.maximum(np.array(model.drivers), 0)])
    first, second, third = (rotation.about_axis(model.axes[:, i], amounts[:, i]) for i in range(3))
    turns = rotation.multiply(rotation.multiply(first, second), third)
    return turns, jnp.einsum("ji,jia->ja", amounts[:, 3:], model.axes[:, 3:])
