"""Regression of joint positions from the surface around them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...body.body import Body
from ...geometry.procrustes import nearest_rotation


class JointRegressor(NamedTuple):
    """The template's joints relative to the surface around them."""

    #: (J, V) weights of the vertices in each joint's position; rows sum to one
    shares: Float[np.ndarray, "J V"]
    vertices: Float[np.ndarray, "V 3"]
    centres: Float[np.ndarray, "J 3"]


def make_joint_regressor(template: Body, width: float = 0.12) -> JointRegressor:
    """Weight, for each joint, the vertices about `width` metres around it that it or its parent moves."""
    skeleton = template.skeleton
    influence = np.asarray(template.skin.bone_weights(skeleton.num_joints), float)
    vertices, centres = np.asarray(template.vertices, float), np.asarray(skeleton.centres, float)
    parents = np.maximum(np.array(skeleton.parents), 0)
    near = np.exp(-0.5 * np.sum((vertices[:, None] - centres[None]) ** 2, -1) / width**2)
    # a joint within others' skin, such as a hip's socket, uses all near vertices
    shares = ((influence + influence[:, parents]) * near + 1e-9 * near + 1e-30).T
    return JointRegressor(shares / shares.sum(1, keepdims=True), vertices, centres)


def regress_joints(regressor: JointRegressor, vertices: Float[np.ndarray, "V 3"]) -> Float[np.ndarray, "J 3"]:
    """Regress joint positions from vertices: fit a similarity to the surface around each joint."""
    old, new = regressor.shares @ regressor.vertices, regressor.shares @ vertices
    places = []
    for joint, shares in enumerate(regressor.shares):
        before, after = regressor.vertices - old[joint], vertices - new[joint]
        turn = nearest_rotation((after * shares[:, None]).T @ before)
        size = np.sqrt((shares @ np.sum(after**2, 1)) / (shares @ np.sum(before**2, 1)))
        places.append(new[joint] + size * turn @ (regressor.centres[joint] - old[joint]))
    return np.stack(places)
