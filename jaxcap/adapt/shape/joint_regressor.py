"""Where joints are by the surface around them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...body.body import Body
from ...geometry.procrustes import nearest_rotation


class Beside(NamedTuple):
    """Where the template's joints are in the surface around them."""

    #: (J, V) which vertices tell of each joint's place; rows sum to one
    shares: Float[np.ndarray, "J V"]
    vertices: Float[np.ndarray, "V 3"]
    centres: Float[np.ndarray, "J 3"]


def make_beside(template: Body, width: float = 0.12) -> Beside:
    """Vertices near a joint that it or its parent moves, `width` metres around it."""
    skeleton = template.skeleton
    influence = np.asarray(template.skin.influence(skeleton.num_joints), float)
    vertices, centres = np.asarray(template.vertices, float), np.asarray(skeleton.centres, float)
    parents = np.maximum(np.array(skeleton.parents), 0)
    near = np.exp(-0.5 * np.sum((vertices[:, None] - centres[None]) ** 2, -1) / width**2)
    # a joint within others' skin, such as a hip's socket, is told by what is near
    shares = ((influence + influence[:, parents]) * near + 1e-9 * near + 1e-30).T
    return Beside(shares / shares.sum(1, keepdims=True), vertices, centres)


def centres_beside(beside: Beside, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "J 3"]:
    """Where joints are when the surface around each has moved by a similarity: what shape alone tells."""
    old, new = beside.shares @ beside.vertices, beside.shares @ vertices
    places = []
    for joint, shares in enumerate(beside.shares):
        before, after = beside.vertices - old[joint], vertices - new[joint]
        turn = nearest_rotation((after * shares[:, None]).T @ before)
        size = np.sqrt((shares @ np.sum(after**2, 1)) / (shares @ np.sum(before**2, 1)))
        places.append(new[joint] + size * turn @ (beside.centres[joint] - old[joint]))
    return np.stack(places)
