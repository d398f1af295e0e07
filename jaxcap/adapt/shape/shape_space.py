"""How people differ, learned from bodies that share the template's triangles."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body
from ...body.decimate import Attachment, attach, follow
from ...body.people.human import human
from ...body.people.random_humans import human_resolution, people_of_many_shapes
from ...body.shape_modes import Modes, moved
from ...geometry.closest import nearest_on_surface
from ...geometry.linear import solve_symmetric

#: ways in which people differ that are told apart, where there are bodies enough
COUNT = 30
#: bodies of the human that tell how people differ, and of which resolution, for templates of other triangles
DRAWN, OTHER = 200, "medium"
#: how often somebody like such a template is brought nearer to it, and how far joints are off in him, metres
ROUNDS, JOINTS_TRUST = 15, 0.1
#: a template is like somebody where this share of its vertices is as near, as a share of its height, and
#: joints on average
MOST, NEAR = 0.95, 0.02


class People(eqx.Module):
    """The template and the main ways in which people differ from each other, each of deviation one."""

    template: Body
    modes: Modes
    #: where the template stands among them
    standing: Float[Array, "K"]


@checked
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


@checked
def people_like(template: Body, whole: Body | None = None) -> People | None:
    """How people differ, where the template has the human's triangles and joints, by humans of many shapes;
    or where the `whole` body has them that the template was reduced from, whose surface its vertices then
    hang on; or where it has other triangles, but the joints and about the surface of some human at rest."""
    of, shift = template if whole is None else whole, np.zeros(3)
    resolution = human_resolution(of)
    if resolution is not None:
        drawn = people_of_many_shapes(DRAWN, resolution=resolution, joints="tracking")
    else:
        one = human(joints="tracking", resolution=OTHER)
        if whole is not None or template.skeleton.names != one.skeleton.names:
            return None
        drawn = people_of_many_shapes(DRAWN, resolution=OTHER, joints="tracking")
        of, shift = someone_like(template, learn_people(one, drawn))
        if not is_like(template, of):
            return None
    if of is not template:
        surface = np.asarray(of.vertices, float) - shift, np.asarray(of.faces)
        hold = attach(np.asarray(template.vertices, float) - shift, *surface)
        drawn = [_carried(template, body, hold, shift) for body in drawn]
    return learn_people(template, drawn)


def someone_like(template: Body, people: People) -> tuple[Body, Float[np.ndarray, "3"]]:
    """The person whose surface comes nearest to a template's with the same joints and other triangles,
    standing where it does, and how far off that is, metres: begun by the joints, then by the nearest points
    of the template, again and again."""
    centres = np.asarray(template.skeleton.centres - people.template.skeleton.centres, float)
    body = person(people, _traits(people.modes.centres, centres, people.standing, JOINTS_TRUST))
    shift = np.asarray(template.skeleton.centres - body.skeleton.centres, float).mean(0)
    vertices, faces = np.asarray(template.vertices, float), np.asarray(template.faces)
    for _ in range(ROUNDS):
        there = nearest_on_surface(np.asarray(body.vertices, float) + shift, vertices, faces)
        places = np.einsum("nk,nka->na", there.shares, vertices[faces[there.triangles]])
        seen = eqx.tree_at(lambda b: b.vertices, body, jnp.asarray(places, body.vertices.dtype))
        body = person(people, traits_like(people, seen))
        shift = (places - np.asarray(body.vertices, float)).mean(0)
    moved_body = eqx.tree_at(
        lambda b: (b.vertices, b.skeleton.centres),
        body,
        (body.vertices + shift, body.skeleton.centres + shift),
    )
    return moved_body, shift


def is_like(template: Body, person: Body) -> bool:
    """Whether a template of other triangles stands as somebody does at rest, surface and joints."""
    vertices = np.asarray(template.vertices, float)
    height = float(np.ptp(vertices, axis=0).max())
    off = nearest_on_surface(vertices, np.asarray(person.vertices, float), np.asarray(person.faces)).distances
    joints = np.linalg.norm(np.asarray(template.skeleton.centres - person.skeleton.centres, float), axis=1)
    return bool(np.quantile(off, MOST) < NEAR * height and np.mean(joints) < NEAR * height)


def _carried(template: Body, body: Body, hold: Attachment, shift: Float[np.ndarray, "3"]) -> Body:
    """Somebody with the template's triangles, who stands where it does."""
    vertices = follow(hold, np.asarray(body.vertices, float)) + shift
    skeleton = eqx.tree_at(lambda s: s.centres, body.skeleton, body.skeleton.centres + shift)
    return Body(skeleton, template.skin, jnp.asarray(vertices, template.vertices.dtype), template.faces)


def person(people: People, traits: Float[Array, "K"]) -> Body:
    """The body at rest of somebody with so much of each way beyond the template."""
    return moved(people.template, people.modes, traits)


def traits_like(people: People, body: Body, trust: float = 0.1) -> Float[Array, "K"]:
    """The traits of the person who is most like a body of the same triangles at rest, wherever it stands:
    least squares of the vertices' shifts, with `trust` the deviation of one that no person explains,
    metres."""
    return _traits(people.modes.vertices, body.vertices - people.template.vertices, people.standing, trust)


def _traits(modes, shifts, standing: Float[Array, "K"], trust: float) -> Float[Array, "K"]:
    """By the shifts of some places, `(N, 3)`, and how the modes move them, `(K, N, 3)`."""
    modes, shifts = np.asarray(modes, float), np.asarray(shifts, float)
    modes = (modes - modes.mean(1, keepdims=True)).reshape(len(modes), -1)
    shifts = (shifts - shifts.mean(0)).reshape(-1)
    # a trait is of deviation one; all places together are one look at a person
    weight = 1.0 / (trust**2 * shifts.size / 3)
    known = np.asarray(standing, float)
    matrix = weight * modes @ modes.T + np.eye(len(modes)) * 1e-3
    traits = solve_symmetric(matrix, weight * modes @ shifts - 1e-3 * known)
    return jnp.asarray(traits, standing.dtype)


def _flat(body: Body) -> Float[np.ndarray, "N"]:
    return np.concatenate(
        [np.asarray(body.skeleton.centres, float), np.asarray(body.vertices, float)]
    ).reshape(-1)
