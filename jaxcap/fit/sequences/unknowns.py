"""Unknowns that the frames of a sequence may share, and the body of their values."""

import abc
import numbers
from collections.abc import Sequence
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ...arguments import check_fields, checked
from ...body.body import Body, scale_body
from ...body.body_model import BodyModel
from ...body.shape_modes import ShapeModes, apply_modes, bone_length_modes
from ...body.skeleton import Skeleton
from ...errors import InputError
from ...geometry import rotation

Value = TypeVar("Value")


class AbstractUnknown(eqx.Module, Generic[Value]):
    """An unknown shared by all frames: its value, and the body of that value.

    Tangents `d (N,)` are flat arrays, in metres, radians or shares of one; `scales` brings them to one
    measure. `apply` may change any array of a body; the changed arrays are detected automatically.
    """

    def __check_init__(self):
        check_fields(self)

    @abc.abstractmethod
    def size(self, body: Body) -> int:
        """Count the components N of a tangent."""

    def component_names(self, body: Body) -> tuple[str, ...]:
        """Name the components of a tangent, by their numbers unless an unknown has better names."""
        return tuple(map(str, range(self.size(body))))

    @abc.abstractmethod
    def start(self, body: Body) -> Value:
        """Make the value that leaves a body unchanged."""

    @abc.abstractmethod
    def apply(self, body: Body, value: Value) -> Body:
        """Change a body by a value."""

    @abc.abstractmethod
    def retract(self, value: Value, d: Float[Array, "N"]) -> Value:
        """Move a value along a tangent."""

    def bounds(self, value: Value) -> tuple[Float[Array, "N"], Float[Array, "N"]] | None:
        """Compute lower and upper bounds of a tangent at a value; None if there are none."""
        del value
        return None

    def scales(self, body: Body) -> Float[Array, "N"]:
        """Compute the scales of a tangent's components; see `AbstractProblem.scales`."""
        return jnp.ones(self.size(body), body.vertices.dtype)


def _number(value: float | Float[Array, ""] | None) -> Float[Array, ""] | None:
    return None if value is None else jnp.asarray(value, float)


class Size(AbstractUnknown[Float[Array, ""]]):
    """The size of the whole body about the origin, within bounds; its value is the logarithm."""

    smallest: Float[Array, ""] | None = eqx.field(converter=_number, default=None)
    largest: Float[Array, ""] | None = eqx.field(converter=_number, default=None)

    def __check_init__(self):
        super().__check_init__()
        for name, end in (("smallest", self.smallest), ("largest", self.largest)):
            if isinstance(end, jax.Array) and not isinstance(end, Tracer) and not end > 0:
                raise InputError(f"Size: `{name}` is {float(end):g}; expected a factor above 0.")

    def size(self, body):
        return 1

    def start(self, body):
        return jnp.zeros((), body.vertices.dtype)

    def apply(self, body, value):
        return scale_body(body, jnp.exp(value))

    def retract(self, value, d):
        return value + d[0]

    def bounds(self, value):
        if self.smallest is None and self.largest is None:
            return None
        low = (
            -jnp.inf
            if self.smallest is None
            else jnp.log(jnp.maximum(self.smallest, 0.0)).astype(value.dtype)
        )
        high = jnp.inf if self.largest is None else jnp.log(self.largest).astype(value.dtype)
        return jnp.reshape(low - value, (1,)), jnp.reshape(high - value, (1,))


class JointCentres(AbstractUnknown[Float[Array, "C 3"]]):
    """The rest centres of some joints; the value is their displacement, metres. The surface stays."""

    joints: tuple[int, ...] = eqx.field(static=True)

    def size(self, body):
        return 3 * len(self.joints)

    def start(self, body):
        return jnp.zeros((len(self.joints), 3), body.vertices.dtype)

    def apply(self, body, value):
        centres = body.skeleton.centres.at[jnp.array(self.joints, int)].add(value)
        return eqx.tree_at(lambda b: b.skeleton.centres, body, centres)

    def retract(self, value, d):
        return value + d.reshape(value.shape)


class JointOrientations(AbstractUnknown[Float[Array, "C 4"]]):
    """The orientations of some joints, which separate twist from swing; the value is quaternions that rotate
    them on the right.

    A roll about a twist axis has no effect, so that tangents are two numbers per joint, radians.
    """

    joints: tuple[int, ...] = eqx.field(static=True)

    def size(self, body):
        return 2 * len(self.joints)

    def start(self, body):
        return jnp.tile(rotation.identity(body.vertices.dtype), (len(self.joints), 1))

    def apply(self, body, value):
        joints = jnp.array(self.joints, int)
        turned = rotation.multiply(body.skeleton.orientations[joints], value)
        orientations = body.skeleton.orientations.at[joints].set(rotation.normalise(turned))
        return eqx.tree_at(lambda b: b.skeleton.orientations, body, orientations)

    def retract(self, value, d):
        turn = jnp.pad(d.reshape(-1, 2), ((0, 0), (1, 0)))
        return rotation.normalise(rotation.multiply(value, rotation.exp(turn)))


class ShapeCoefficients(AbstractUnknown[Float[Array, "K"]]):
    """Coefficients of the modes of a shape space, of joints and surface together (`ShapeModes`), within bounds."""

    modes: ShapeModes
    lowest: Float[Array, "K"] | None = None
    highest: Float[Array, "K"] | None = None
    #: of the coefficients, for descriptions; their numbers if empty
    names: tuple[str, ...] = eqx.field(static=True, default=())

    def component_names(self, body):
        return self.names or super().component_names(body)

    def size(self, body):
        return len(self.modes.centres)

    def start(self, body):
        return jnp.zeros(self.size(body), body.vertices.dtype)

    def apply(self, body, value):
        return apply_modes(body, self.modes, value)

    def retract(self, value, d):
        return value + d

    def bounds(self, value):
        if self.lowest is None and self.highest is None:
            return None
        low, high = (jnp.full_like(value, sign * jnp.inf) for sign in (-1, 1))
        low = low if self.lowest is None else self.lowest - value
        return low, high if self.highest is None else self.highest - value


@checked
def model_coefficients(model: BodyModel) -> ShapeCoefficients:
    """Make the unknown of a model's coefficients, relative to the template's, within the bounds of the model."""
    low, high = (
        None if end is None else end - model.template_coefficients for end in (model.lowest, model.highest)
    )
    return ShapeCoefficients(model.modes, low, high)


@checked
def bone_length_changes(
    body: Body,
    joints: Sequence[int | str | Sequence[int | str]] | None = None,
    *,
    move_surface: bool = True,
    largest_change: float | None = 0.5,
) -> ShapeCoefficients:
    """Make the unknown of relative changes of bone lengths; directions at rest stay.

    The bone of a joint is the one that ends at it, from its parent: that of a knee is the thigh.

    **Arguments:** `joints` by index or name; several joints in one entry, such as left and right, have one common change; by
    default each bone with a length is an unknown of its own. With `move_surface` the surface stretches with the bones. No length
    changes by more than the share `largest_change`; None for no bounds.

    **Raises:** `InputError` for joints without a bone or given twice, and for a change that is not above 0.
    """
    if largest_change is not None and not largest_change > 0:
        raise InputError(
            f"bone_length_changes: `largest_change` is {largest_change:g}; expected a share above 0."
        )
    skeleton = body.skeleton
    if joints is None:
        centres = np.asarray(skeleton.centres)
        joints = [
            joint
            for joint, parent in enumerate(skeleton.parents)
            if parent >= 0 and np.linalg.norm(centres[joint] - centres[parent]) > 0
        ]
    groups = [
        [
            _joint_index(skeleton, joint)
            for joint in (each if isinstance(each, Sequence) and not isinstance(each, str) else [each])
        ]
        for each in joints
    ]
    given = [joint for group in groups for joint in group]
    twice = sorted({joint for joint in given if given.count(joint) > 1})
    if twice:
        raise InputError(
            f"bone_length_changes: `joints` has {skeleton.names[twice[0]]} twice; expected each joint once."
        )
    if not all(groups):
        raise InputError("bone_length_changes: `joints` has an entry without joints; leave it out.")
    modes = bone_length_modes(body, groups, move_surface)
    end = None if largest_change is None else jnp.full(len(groups), largest_change, body.vertices.dtype)
    names = tuple("+".join(skeleton.names[joint] for joint in group) for group in groups)
    return ShapeCoefficients(modes, None if end is None else -end, end, names)


def _joint_index(skeleton: Skeleton, joint: Any) -> int:
    if isinstance(joint, str):
        if joint not in skeleton.names:
            raise InputError(
                f"bone_length_changes: there is no joint '{joint}'; the body has {', '.join(skeleton.names)}."
            )
        return skeleton.names.index(joint)
    if not isinstance(joint, numbers.Integral):
        raise InputError(f"bone_length_changes: `joints` has {joint!r}; expected indices or names of joints.")
    return int(joint)


class RestVertices(AbstractUnknown[Float[Array, "C 3"]]):
    """The rest positions of some vertices, such as markers on bones; the value is their displacement, metres.

    The equations are dense in them: not for whole surfaces.
    """

    vertices: tuple[int, ...] = eqx.field(static=True)

    def size(self, body):
        return 3 * len(self.vertices)

    def start(self, body):
        return jnp.zeros((len(self.vertices), 3), body.vertices.dtype)

    def apply(self, body, value):
        vertices = body.vertices.at[jnp.array(self.vertices, int)].add(value)
        return eqx.tree_at(lambda b: b.vertices, body, vertices)

    def retract(self, value, d):
        return value + d.reshape(value.shape)


class SkinningWeights(AbstractUnknown[Float[Array, "C K"]]):
    """The skinning weights of some vertices for some bones, at least zero and with the same sum as at the
    start.

    The value is these weights; the last of the bones has the remainder.
    """

    vertices: tuple[int, ...] = eqx.field(static=True)
    bones: tuple[int, ...] = eqx.field(static=True)

    def size(self, body):
        return len(self.vertices) * (len(self.bones) - 1)

    def start(self, body):
        return self._weights(body)[self._indices()]

    def apply(self, body, value):
        changed = self._weights(body).at[self._indices()].set(value)
        return eqx.tree_at(lambda b: b.skin.weights, body, changed)

    def retract(self, value, d):
        whole = jnp.sum(value, 1, keepdims=True)
        most = jnp.maximum(value[:, :-1] + d.reshape(len(value), -1), 0.0)
        share = jnp.sum(most, 1, keepdims=True)
        most = most * jnp.where(share > whole, whole / jnp.where(share > 0, share, 1.0), 1.0)
        return jnp.concatenate([most, jnp.maximum(whole - jnp.sum(most, 1, keepdims=True), 0.0)], 1)

    def bounds(self, value):
        most = value[:, :-1]
        return -most.reshape(-1), (jnp.sum(value, 1, keepdims=True) - most).reshape(-1)

    def _indices(self):
        return np.array(self.vertices, int)[:, None], np.array(self.bones, int)

    def _weights(self, body: Body) -> Float[Array, "V J"]:
        weights = getattr(body.skin, "weights", None)
        if weights is None:
            raise InputError(
                f"SkinningWeights: a {type(body.skin).__name__} has no matrix of weights by vertex and "
                "bone; give a body with a LinearSkin or a DualQuaternionSkin."
            )
        return weights


def make_body(body: Body, unknowns: dict[str, AbstractUnknown], values: dict) -> Body:
    """Apply all unknowns in the order of their names."""
    for name in sorted(unknowns):
        body = unknowns[name].apply(body, values[name])
    return body


def split_tangent(
    body: Body, unknowns: dict[str, AbstractUnknown], d: Float[Array, "S"]
) -> dict[str, Float[Array, "N"]]:
    """Split a tangent of all unknowns by unknown."""
    names = sorted(unknowns)
    ends = _offsets(body, [unknowns[name] for name in names])
    return dict(zip(names, jnp.split(d, ends[:-1]) if names else [], strict=True))


def _offsets(body: Body, unknowns: Sequence[AbstractUnknown]) -> list[int]:
    ends, total = [], 0
    for unknown in unknowns:
        total += unknown.size(body)
        ends.append(total)
    return ends
