"""Truncation of skinning weights to the strongest bones of each vertex, for programs that limit their
number."""

import numpy as np
from jaxtyping import Float, Int


def strongest_bones(
    weights: Float[np.ndarray, "V J"], count: int
) -> tuple[Int[np.ndarray, "V K"], Float[np.ndarray, "V K"]]:
    """Find the `count` bones of largest weight for each vertex, and their weights normalised to sum one.

    Bones are in descending order of weight; among equal weights the lower index comes first. All bones are
    returned where there are fewer.
    """
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(weights, bones, 1)
    return bones, kept / kept.sum(1, keepdims=True)


def strongest_weights(weights: Float[np.ndarray, "V J"], count: int) -> Float[np.ndarray, "V J"]:
    """Keep the weights of the `strongest_bones` of each vertex, normalised, and set all others to zero."""
    few = np.zeros_like(weights)
    np.put_along_axis(few, *strongest_bones(weights, count), 1)
    return few
