"""Placement of a human skeleton in the mesh of a person."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body, Posed
from ..body.skeleton import Skeleton, make_skeleton
from ..body.skin import LinearSkin
from ..errors import InputError
from ..geometry import rotation
from ..units import UNIT_NAMES, units_within
from .heat import smooth_weights, surface_operators
from .register_template import find_closest, make_surface_samples, register, search_tree
from .template import Template, load_template, pose_template

#: limits of a person's height, metres
SHORTEST, TALLEST = 0.3, 3.0
#: usual heights of people, metres; they suggest the unit of a mesh
USUAL_HEIGHT = (1.0, 2.2)
#: height to which the mesh is scaled, metres; all lengths of a registration are for this height
STATURE = 1.75
#: mean distance between template and mesh at that height above which the registration failed, metres
POOR_FIT = 0.06
#: distance from the template at which a vertex's weights have a confidence of a half, metres
CONFIDENCE_DISTANCE = 0.05
#: distance over which weights are smoothed, metres
SMOOTHING = 0.02
#: number of points of the template's surface with transferable weights, and number of them used per vertex
NUM_SOURCES, NUM_NEIGHBOURS = 12000, 4
#: rotations that take the axis that points up to y
UPRIGHT = {
    "x": [[0.0, -1, 0], [1, 0, 0], [0, 0, 1]],
    "y": [[1.0, 0, 0], [0, 1, 0], [0, 0, 1]],
    "z": [[1.0, 0, 0], [0, 0, 1], [0, -1, 0]],
}


def place_human(
    vertices: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    up: Literal["x", "y", "z"] = "y",
) -> Body:
    """Place the human skeleton in the mesh of an upright person with the arms off the body.

    The built-in human, of unknown build, pose and heading, is registered to the mesh and provides the joints.
    Each vertex takes its weights from the closest points of the registered surface with a similar normal;
    they are smoothed over the mesh. The rest pose of the new body is the given mesh in its own coordinate
    frame; joints and their axes are transformed to it. The bones are those of `human(joints="tracking")`.

    **Arguments:** `vertices` metres; `faces` counter-clockwise from outside; `up` is the axis that
    points up. Vertices of no triangle and triangles without area are tolerated.

    **Raises:** `InputError` if the mesh does not have a person's height, or if the registration ends too far
    from it, with the value found.
    """
    unit = person_height(vertices, faces, up) / STATURE
    turn = np.array(UPRIGHT[up])
    upright = vertices @ turn.T / unit
    template = load_template()
    found = register(template, make_surface_samples(upright, faces))
    if found.residual > POOR_FIT:
        raise InputError(
            f"The best fit of the human to the mesh has a mean distance of {1e3 * unit * found.residual:.0f} mm; "
            f"expected at most {1e3 * unit * POOR_FIT:.0f} mm; give the mesh of one person, upright along {up}, "
            "with the arms away from the body and the triangles facing outwards."
        )
    posed = pose_template(template, found.person)
    return Body(
        _transform_skeleton(template, posed, unit, turn),
        LinearSkin(jnp.asarray(_transfer_weights(template, posed, upright, faces), posed.vertices.dtype)),
        jnp.asarray(vertices, posed.vertices.dtype),
        jnp.asarray(faces, jnp.int32),
    )


def person_height(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], up: str = "y") -> float:
    """Compute the height of a mesh, metres, and check that it is a person's.

    **Raises:** `InputError` if it is not.
    """
    if up not in UPRIGHT:
        raise InputError(f"The axis that points up is '{up}'; give 'x', 'y' or 'z'.")
    height = float(np.ptp(vertices[np.unique(faces), "xyz".index(up)]))
    if SHORTEST <= height <= TALLEST:
        return height
    likely = units_within(height, *USUAL_HEIGHT)
    advice = (
        f"its unit is probably {UNIT_NAMES[likely[0]]}; scale it to metres"
        if likely
        else "scale it to metres"
    )
    raise InputError(
        f"The mesh is {height:.4g} m tall along {up}; expected the height of a person, {SHORTEST:g} to "
        f"{TALLEST:g} m; {advice}, or name the axis that points up."
    )


def _transform_skeleton(template: Template, posed: Posed, unit: float, upright: np.ndarray) -> Skeleton:
    """Transform the posed joints to the frame and the size of the mesh."""
    skeleton = template.body.skeleton
    back = upright.T @ np.asarray(posed.transforms.rotations, float)
    frames = back @ np.asarray(rotation.to_matrix(skeleton.orientations), float)
    return make_skeleton(
        skeleton.names,
        skeleton.parents,
        skeleton.kinds,
        centres=unit * np.asarray(posed.joints, float) @ upright,
        orientations=rotation.from_matrix(jnp.asarray(frames)),
        axes=np.einsum("jab,jkb->jka", back, np.asarray(skeleton.axes, float)),
    )


def _transfer_weights(
    template: Template, posed: Posed, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V J"]:
    """Transfer weights from the closest points of the posed template, with more confidence in closer ones."""
    donors = make_surface_samples(
        np.asarray(posed.vertices, float), np.asarray(template.body.faces), NUM_SOURCES
    )
    weights = np.asarray(template.body.skin.bone_weights(template.body.skeleton.num_joints), float)
    donated = np.einsum("nc,ncj->nj", donors.barycentric, weights[donors.corners])
    normals = surface_operators(vertices, faces)[2]
    distances, near = find_closest(
        search_tree(donors.points, donors.normals), vertices, normals, NUM_NEIGHBOURS
    )
    shares = 1 / (distances + 1e-3)
    carried = np.einsum("nk,nkj->nj", shares / shares.sum(axis=1, keepdims=True), donated[near])
    trust = 1 / (1 + (distances[:, 0] / CONFIDENCE_DISTANCE) ** 2)
    return smooth_weights(vertices, faces, carried, trust**2, SMOOTHING)
