"""How people differ, learned from bodies that share the template's triangles."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..body.body import Body
from ..body.reduce import Attachment, attach, follow
from ..body.variety import human_resolution, people_of_many_shapes
from .modes import Modes, moved

#: ways in which people differ that are told apart, where there are bodies enough
COUNT = 30
#: bodies of the human that tell how people differ
DRAWN = 200


class People(eqx.Module):
    """The template and the main ways in which people differ from each other, each of deviation one."""

    template: Body
    modes: Modes
    #: where the template stands among them
    standing: Float[Array, "K"]


def learn_people(template: Body, bodies: Sequence[Body], count: int = COUNT) -> People:
    """The main ways in which bodies differ at rest, joints and vertices together, by principal components.

    **Arguments:** `bodies`, at least two, share the template's triangles, joints and rest pose.

    **Raises:** `ValueError` where one has other numbers of vertices or joints, or there are fewer than two.
    """
    if len(bodies) < 2:
        raise ValueError(f"{len(bodies)} bodies do not show how people differ; give at least two.")
    vertices, joints = len(template.vertices), template.skeleton.num_joints
    for number, body in enumerate(bodies):
        if len(body.vertices) != vertices or body.skeleton.num_joints != joints:
            raise ValueError(
                f"Body {number} has {len(body.vertices)} vertices and {body.skeleton.num_joints} joints, the template "
                f"{vertices} and {joints}; give bodies that share its triangles."
            )
    rows = np.stack([_flat(body) for body in bodies])
    mean = rows.mean(0)
    _, sizes, axes = np.linalg.svd(rows - mean, full_matrices=False)
    count = min(count, int(np.sum(sizes > 1e-6 * sizes[0])))
    deviations = sizes[:count] / np.sqrt(len(bodies) - 1)
    directions = (axes[:count] * deviations[:, None]).reshape(count, -1, 3)
    standing = axes[:count] @ (_flat(template) - mean) / deviations
    dtype = template.vertices.dtype
    modes = Modes(jnp.asarray(directions[:, :joints], dtype), jnp.asarray(directions[:, joints:], dtype))
    return People(template, modes, jnp.asarray(standing, dtype))


def people_like(template: Body, whole: Body | None = None) -> People | None:
    """How people differ, where the template has the human's triangles and joints, by humans of many shapes; or where the
    `whole` body has them that the template was reduced from, whose surface its vertices then hang on."""
    of = template if whole is None else whole
    resolution = human_resolution(of)
    if resolution is None:
        return None
    drawn = people_of_many_shapes(DRAWN, resolution=resolution, joints="tracking")
    if whole is not None:
        surface = np.asarray(whole.vertices, float), np.asarray(whole.faces)
        hold = attach(np.asarray(template.vertices, float), *surface)
        drawn = [_carried(template, body, hold) for body in drawn]
    return learn_people(template, drawn)


def _carried(template: Body, body: Body, hold: Attachment) -> Body:
    """Somebody with the template's triangles."""
    vertices = follow(hold, np.asarray(body.vertices, float))
    return Body(body.skeleton, template.skin, jnp.asarray(vertices, template.vertices.dtype), template.faces)


def person(people: People, traits: Float[Array, "K"]) -> Body:
    """The body at rest of somebody with so much of each way beyond the template."""
    return moved(people.template, people.modes, traits)


def traits_like(people: People, body: Body, trust: float = 0.1) -> Float[Array, "K"]:
    """The traits of the person who is most like a body of the same triangles at rest, wherever it stands: least
    squares of the vertices' shifts, with `trust` the deviation of one that no person explains, metres."""
    modes = np.asarray(people.modes.vertices, float)
    modes = (modes - modes.mean(1, keepdims=True)).reshape(len(modes), -1)
    shifts = np.asarray(body.vertices - people.template.vertices, float)
    shifts = (shifts - shifts.mean(0)).reshape(-1)
    # a trait is of deviation one; all vertices together are one look at a person
    weight = 1.0 / (trust**2 * shifts.size / 3)
    standing = np.asarray(people.standing, float)
    matrix = weight * modes @ modes.T + np.eye(len(modes)) * 1e-3
    traits = np.linalg.solve(matrix, weight * modes @ shifts - 1e-3 * standing)
    return jnp.asarray(traits, people.standing.dtype)


def _flat(body: Body) -> Float[np.ndarray, "N"]:
    return np.concatenate(
        [np.asarray(body.skeleton.centres, float), np.asarray(body.vertices, float)]
    ).reshape(-1)
