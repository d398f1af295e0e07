"""A human skeleton put into the mesh of a person."""

from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from ..body.body import Body, Posed
from ..body.skeleton import Skeleton, make_skeleton
from ..body.skin import LinearSkin
from ..errors import InputError
from ..geometry import rotation
from .heat import smooth_weights, surface_operators
from .register import closest, register, sample_surface, search_tree
from .template import Template, load_template, pose_template

#: metres; heights of a person that stands
SHORTEST, TALLEST = 0.3, 3.0
#: metres; the mesh is brought to this height, for which all lengths of a registration are meant
STATURE = 1.75
#: metres at that height; a template farther than this from the mesh, on average, was not found in it
POOR_FIT = 0.06
#: metres; a vertex this far from the template is trusted by half with its weights
TRUST = 0.05
#: metres; weights are smoothed over about this far
SMOOTHING = 0.02
#: points of the template's surface that hand their weights on, and how many a vertex asks
DONORS, ASKED = 12000, 4
#: rotations that bring an axis that points up to y
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
    """A body of a mesh that shows a person upright, arms held off: the human skeleton put into it.

    The embedded human, of unknown build, pose and heading, is registered to the mesh; its joints
    stay where they come to lie, and each vertex takes its weights from the closest point of the
    registered surface whose normal is like its own, smoothed over the mesh. The rest pose of the
    new body is the mesh as it stands, joints and their own axes carried along, in the frame that it
    came in. The bones are those of `human(joints="tracking")`.

    **Arguments:** `vertices` metres; `faces` counter-clockwise from outside; `up` is the axis that
    points up. Vertices of no triangle and triangles without area are tolerated.

    **Raises:** `InputError` where the mesh is not of a person's height, or where the registration
    ends too far from it; both name what was found.
    """
    unit = check_person(vertices, faces, up) / STATURE
    turn = np.array(UPRIGHT[up])
    upright = vertices @ turn.T / unit
    template = load_template()
    found = register(template, sample_surface(upright, faces))
    if found.residual > POOR_FIT:
        raise InputError(
            f"The human that fits the mesh best is {1e3 * unit * found.residual:.0f} mm away from it on "
            f"average, more than {1e3 * unit * POOR_FIT:.0f} mm; give the mesh of one person who stands upright "
            f"along {up}, with the arms off the body and the triangles facing outwards."
        )
    posed = pose_template(template, found.person)
    return Body(
        _carry_skeleton(template, posed, unit, turn),
        LinearSkin(jnp.asarray(_carry_weights(template, posed, upright, faces), posed.vertices.dtype)),
        jnp.asarray(vertices, posed.vertices.dtype),
        jnp.asarray(faces, jnp.int32),
    )


def check_person(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"], up: str = "y") -> float:
    """The height of a mesh, metres. Raises `InputError` with one sentence where no person has it."""
    if up not in UPRIGHT:
        raise InputError(f"The axis that points up is '{up}'; give 'x', 'y' or 'z'.")
    height = float(np.ptp(vertices[np.unique(faces), "xyz".index(up)]))
    if SHORTEST <= height <= TALLEST:
        return height
    units = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254}
    likely = [unit for unit, metres in units.items() if 1.0 <= height * metres <= 2.2]
    advice = f"it is likely in {likely[0]}, so scale it to metres" if likely else "scale it to metres"
    raise InputError(
        f"The mesh is {height:.4g} m tall along {up}, where a person is between {SHORTEST:g} and "
        f"{TALLEST:g} m; {advice}, or name the axis that points up."
    )


def _carry_skeleton(template: Template, posed: Posed, unit: float, turn: np.ndarray) -> Skeleton:
    """The joints as they are posed, in the frame and the size of the mesh."""
    skeleton = template.body.skeleton
    back = turn.T @ np.asarray(posed.transforms.rotations, float)
    frames = back @ np.asarray(rotation.to_matrix(skeleton.orientations), float)
    return make_skeleton(
        skeleton.names,
        skeleton.parents,
        skeleton.kinds,
        centres=unit * np.asarray(posed.joints, float) @ turn,
        orientations=rotation.from_matrix(jnp.asarray(frames)),
        axes=np.einsum("jab,jkb->jka", back, np.asarray(skeleton.axes, float)),
    )


def _carry_weights(
    template: Template, posed: Posed, vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
) -> Float[np.ndarray, "V J"]:
    """The weights of the closest points of the posed template, trusted as far as they are close."""
    donors = sample_surface(np.asarray(posed.vertices, float), np.asarray(template.body.faces), DONORS)
    weights = np.asarray(template.body.skin.influence(template.body.skeleton.num_joints), float)
    donated = np.einsum("nc,ncj->nj", donors.shares, weights[donors.corners])
    normals = surface_operators(vertices, faces)[2]
    distances, near = closest(search_tree(donors.points, donors.normals), vertices, normals, ASKED)
    shares = 1 / (distances + 1e-3)
    carried = np.einsum("nk,nkj->nj", shares / shares.sum(axis=1, keepdims=True), donated[near])
    trust = 1 / (1 + (distances[:, 0] / TRUST) ** 2)
    return smooth_weights(vertices, faces, carried, trust**2, SMOOTHING)
