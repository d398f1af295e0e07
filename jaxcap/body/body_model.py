"""Body models: bodies whose shape depends on coefficients."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..arguments import check_fields, checked
from ..errors import InputError
from ..geometry.linear import solve_symmetric
from .body import Body
from .shape_modes import ShapeModes, apply_modes


class BodyModel(eqx.Module):
    """A template and linear shape modes: coefficients and a pose give a surface.

    The joints move with the surface: their modes are those of the surface, multiplied by the matrix that regresses the joints
    from the vertices (SMPL, Loper et al. 2015, eqs. 8 and 10). Displacements that depend on the pose belong to the skin of the
    template (`CorrectedSkin`). Coefficients have a standard deviation of one among people.
    """

    template: Body
    modes: ShapeModes
    #: the coefficients of the template's own shape
    template_coefficients: Float[Array, "K"]
    #: names and numbers of coefficients of all groups, such as `(("betas", 10), ("expression", 10))`, in their order
    groups: tuple[tuple[str, int], ...] = eqx.field(static=True, default=())
    #: the family of the model, such as `SMPL-X`; empty if it has none
    family: str = eqx.field(static=True, default="")
    #: lowest and highest coefficients of a fit, such as 0 and 1 of a shape key; without bounds if None
    lowest: Float[Array, "K"] | None = None
    highest: Float[Array, "K"] | None = None

    def __check_init__(self):
        check_fields(self)
        count, grouped = len(self.template_coefficients), sum(size for _, size in self.groups)
        if self.groups and grouped != count:
            raise InputError(
                f"BodyModel: the groups have {grouped} coefficients, and `template_coefficients` {count}; expected the same "
                "number."
            )
        for name, modes, there in (
            ("centres", self.modes.centres, self.template.skeleton.num_joints),
            ("vertices", self.modes.vertices, len(self.template.vertices)),
        ):
            if modes.shape[:2] != (count, there):
                raise InputError(
                    f"BodyModel: `modes.{name}` has the shape {modes.shape}; expected ({count}, {there}, 3) for {count} "
                    "coefficients."
                )


@checked
def shape_body(
    model: BodyModel,
    coefficients: Float[Array | np.ndarray, "..."] | None = None,
    **groups: Float[Array | np.ndarray, "..."],
) -> Body:
    """Make the body of given coefficients, in the template's pose at rest.

    **Arguments:** `coefficients`, all of them, in the order of `model.groups`, or groups by their names, as in
    `shape_body(model, betas=betas, expression=expression)`. Missing ones at the end of a group, and missing groups, are those
    of the template.

    **Raises:** `InputError` if there are more coefficients than the model has, or no group of a name.
    """
    values = _all_coefficients(model, coefficients, **groups)
    return shape_from_template(model, values - model.template_coefficients)


@checked
def body_coefficients(model: BodyModel, body: Body) -> Float[Array, "K"]:
    """Find the coefficients of a body that the model makes, from its vertices at rest.

    **Raises:** `InputError` if the body has other vertices than the model.
    """
    if body.vertices.shape != model.template.vertices.shape:
        raise InputError(
            f"body_coefficients: the body has {len(body.vertices)} vertices and the model {len(model.template.vertices)}; expected "
            "a body of this model."
        )
    count = len(model.template_coefficients)
    if not count:
        return model.template_coefficients
    shifts = (np.asarray(body.vertices, float) - np.asarray(model.template.vertices, float)).reshape(-1)
    modes = np.asarray(model.modes.vertices, float).reshape(count, -1)
    matrix = modes @ modes.T
    # a mode without displacements has a coefficient of zero
    matrix += np.eye(count) * (1e-12 * np.trace(matrix) + np.finfo(float).tiny)
    changes = solve_symmetric(matrix, modes @ shifts)
    return model.template_coefficients + jnp.asarray(changes, model.template_coefficients.dtype)


@checked
def split_coefficients(
    model: BodyModel, coefficients: Float[np.ndarray, "*frames K"]
) -> dict[str, Float[np.ndarray, "*frames N"]]:
    """Split all coefficients of a model into its groups."""
    found, first = {}, 0
    for name, size in model.groups:
        found[name], first = coefficients[..., first : first + size], first + size
    return found


def shape_from_template(model: BodyModel, changes: Float[Array, "K"]) -> Body:
    """Make the body whose coefficients differ from the template's by `changes`."""
    return apply_modes(model.template, model.modes, changes)


def _all_coefficients(
    model: BodyModel,
    coefficients: Float[Array | np.ndarray, "..."] | None = None,
    **groups: Float[Array | np.ndarray, "..."],
) -> Float[Array, "K"]:
    """Collect all coefficients from the arguments of `shape_body`."""
    values, dtype = model.template_coefficients, model.template_coefficients.dtype
    spans, first = {"coefficients": (0, len(values))}, 0
    for name, size in model.groups:
        spans[name], first = (first, size), first + size
    given = groups if coefficients is None else {"coefficients": coefficients, **groups}
    for name, some in given.items():
        if name not in spans:
            there = ", ".join(name for name, _ in model.groups)
            raise InputError(
                f"shape_body: the model has no group of coefficients '{name}'; "
                + (f"it has {there}." if there else "give `coefficients`.")
            )
        if jnp.ndim(some) != 1:
            raise InputError(
                f"shape_body: `{name}` has the shape {jnp.shape(some)}; expected the coefficients of one person; `jax.vmap` makes "
                "bodies of many."
            )
        at, size = spans[name]
        if len(some) > size:
            raise InputError(
                f"shape_body: {len(some)} {name} were given, and the model has {size}; read the model with more coefficients, or "
                "give fewer."
            )
        values = values.at[at : at + len(some)].set(jnp.asarray(some, dtype))
    return values
