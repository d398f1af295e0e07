"""A shape space of people, learned from bodies that share the template's triangles."""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...arguments import checked
from ...body.body import Body
from ...body.body_model import BodyModel, shape_from_template
from ...body.people.human import human
from ...body.people.random_humans import human_resolution, sample_humans
from ...body.shape_modes import ShapeModes
from ...geometry.attachment import Attachment, attach_points, attached_positions
from ...geometry.closest import nearest_on_surface, positions_on_surface
from ...geometry.linear import solve_symmetric

#: number of shape modes, if there are enough bodies
COUNT = 30
#: number of sampled humans, and their resolution for templates of other triangles
NUM_SAMPLES, DEFAULT_RESOLUTION = 200, "medium"
#: iterations of the fit of a person to such a template, and standard deviation of its joints, metres
NUM_FIT_ITERATIONS, JOINT_DEVIATION = 15, 0.1
#: a template is similar to a person if this share of its vertices, and its joints on average, are nearer than
#: the second share of its height
MIN_MATCHED_SHARE, MAX_MATCHED_DISTANCE = 0.95, 0.02


@checked
def learn_shape_space(template: Body, bodies: Sequence[Body], count: int = COUNT) -> BodyModel:
    """Learn the principal components of bodies at rest, over joints and vertices together.

    **Arguments:** `bodies`, at least two, share the template's triangles, joints and rest pose.

    **Raises:** `ValueError` if one has other numbers of vertices or joints, or there are fewer than two.
    """
    if len(bodies) < 2:
        raise ValueError(f"A shape space cannot be learned from {len(bodies)} bodies; give at least two.")
    vertices, joints = len(template.vertices), template.skeleton.num_joints
    for number, body in enumerate(bodies):
        if len(body.vertices) != vertices or body.skeleton.num_joints != joints:
            raise ValueError(
                f"Body {number} has {len(body.vertices)} vertices and {body.skeleton.num_joints} joints; expected "
                f"{vertices} and {joints}, as in the template; give bodies that share its triangles."
            )
    rows = np.stack([_flatten_body(body) for body in bodies])
    mean = rows.mean(0)
    _, sizes, axes = np.linalg.svd(rows - mean, full_matrices=False)
    count = min(count, int(np.sum(sizes > 1e-6 * sizes[0])))
    deviations = sizes[:count] / np.sqrt(len(bodies) - 1)
    directions = (axes[:count] * deviations[:, None]).reshape(count, -1, 3)
    coefficients = axes[:count] @ (_flatten_body(template) - mean) / deviations
    dtype = template.vertices.dtype
    modes = ShapeModes(jnp.asarray(directions[:, :joints], dtype), jnp.asarray(directions[:, joints:], dtype))
    return BodyModel(template, modes, jnp.asarray(coefficients, dtype))


@checked
def shape_space_like(template: Body, full_body: Body | None = None) -> BodyModel | None:
    """Learn the shape space of sampled humans for a template; None if the template is not like a human.

    The template, or the `full_body` body that it was reduced from, has the human's triangles and joints; or the
    template has other triangles, but the joints and about the surface of some human at rest. In the last two
    cases the template's vertices are attached to that surface.
    """
    source, shift = template if full_body is None else full_body, np.zeros(3)
    resolution = human_resolution(source)
    if resolution is not None:
        sampled = sample_humans(NUM_SAMPLES, resolution=resolution, joints="tracking")
    else:
        one = human(joints="tracking", resolution=DEFAULT_RESOLUTION)
        if full_body is not None or template.skeleton.names != one.skeleton.names:
            return None
        sampled = sample_humans(NUM_SAMPLES, resolution=DEFAULT_RESOLUTION, joints="tracking")
        source, shift = fit_person(template, learn_shape_space(one, sampled))
        if not is_similar(template, source):
            return None
    if source is not template:
        surface = np.asarray(source.vertices, float) - shift, np.asarray(source.faces)
        attachment = attach_points(np.asarray(template.vertices, float) - shift, *surface)
        sampled = [_transfer_body(template, body, attachment, shift) for body in sampled]
    return learn_shape_space(template, sampled)


def fit_person(template: Body, shape_space: BodyModel) -> tuple[Body, Float[np.ndarray, "3"]]:
    """Fit a person to a template with the same joints and other triangles.

    The fit starts from the joints; then it alternates with closest points on the template. Return the person
    at the template's position, and its shift from the shape space's position, metres.
    """
    centres = np.asarray(template.skeleton.centres - shape_space.template.skeleton.centres, float)
    body = shape_from_template(
        shape_space,
        _fit_coefficients(
            shape_space.modes.centres, centres, shape_space.template_coefficients, JOINT_DEVIATION
        ),
    )
    shift = np.asarray(template.skeleton.centres - body.skeleton.centres, float).mean(0)
    vertices, faces = np.asarray(template.vertices, float), np.asarray(template.faces)
    for _ in range(NUM_FIT_ITERATIONS):
        nearest = nearest_on_surface(np.asarray(body.vertices, float) + shift, vertices, faces)
        positions = positions_on_surface(nearest, vertices, faces)
        seen = eqx.tree_at(lambda b: b.vertices, body, jnp.asarray(positions, body.vertices.dtype))
        body = shape_from_template(shape_space, fit_coefficients(shape_space, seen))
        shift = (positions - np.asarray(body.vertices, float)).mean(0)
    moved_body = eqx.tree_at(
        lambda b: (b.vertices, b.skeleton.centres),
        body,
        (body.vertices + shift, body.skeleton.centres + shift),
    )
    return moved_body, shift


def is_similar(template: Body, person: Body) -> bool:
    """Test if a template of other triangles matches a person at rest, in surface and joints."""
    vertices = np.asarray(template.vertices, float)
    height = float(np.ptp(vertices, axis=0).max())
    off = nearest_on_surface(vertices, np.asarray(person.vertices, float), np.asarray(person.faces)).distances
    joints = np.linalg.norm(np.asarray(template.skeleton.centres - person.skeleton.centres, float), axis=1)
    return bool(
        np.quantile(off, MIN_MATCHED_SHARE) < MAX_MATCHED_DISTANCE * height
        and np.mean(joints) < MAX_MATCHED_DISTANCE * height
    )


def _transfer_body(template: Body, body: Body, attachment: Attachment, shift: Float[np.ndarray, "3"]) -> Body:
    """Convert a body to the template's triangles and position."""
    vertices = attached_positions(attachment, np.asarray(body.vertices, float)) + shift
    skeleton = eqx.tree_at(lambda s: s.centres, body.skeleton, body.skeleton.centres + shift)
    return Body(skeleton, template.skin, jnp.asarray(vertices, template.vertices.dtype), template.faces)


def fit_coefficients(shape_space: BodyModel, body: Body, deviation: float = 0.1) -> Float[Array, "K"]:
    """Fit shape coefficients to a body of the same triangles at rest, at any position.

    This is least squares of the vertices' shifts; `deviation` is the standard deviation of a residual, metres.
    """
    return _fit_coefficients(
        shape_space.modes.vertices,
        body.vertices - shape_space.template.vertices,
        shape_space.template_coefficients,
        deviation,
    )


def _fit_coefficients(
    modes, shifts, template_coefficients: Float[Array, "K"], deviation: float
) -> Float[Array, "K"]:
    """Fit coefficients to shifts of some points, `(N, 3)`, with modes `(K, N, 3)`."""
    modes, shifts = np.asarray(modes, float), np.asarray(shifts, float)
    modes = (modes - modes.mean(1, keepdims=True)).reshape(len(modes), -1)
    shifts = (shifts - shifts.mean(0)).reshape(-1)
    # all points together count as one measurement, as their errors are correlated
    weight = 1.0 / (deviation**2 * shifts.size / 3)
    known = np.asarray(template_coefficients, float)
    matrix = weight * modes @ modes.T + np.eye(len(modes)) * 1e-3
    coefficients = solve_symmetric(matrix, weight * modes @ shifts - 1e-3 * known)
    return jnp.asarray(coefficients, template_coefficients.dtype)


def _flatten_body(body: Body) -> Float[np.ndarray, "N"]:
    return np.concatenate(
        [np.asarray(body.skeleton.centres, float), np.asarray(body.vertices, float)]
    ).reshape(-1)
