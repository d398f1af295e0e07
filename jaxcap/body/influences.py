"""The bones that move each vertex most, as programs that let only so many move it need them."""

import numpy as np
from jaxtyping import Float, Int


def strongest_bones(
    weights: Float[np.ndarray, "V J"], count: int
) -> tuple[Int[np.ndarray, "V K"], Float[np.ndarray, "V K"]]:
    """The `count` bones, or all where there are fewer, of the largest weights of each vertex, strongest first and of
    equal ones the first; and their weights, which sum to one."""
    bones = np.argsort(-weights, axis=1, kind="stable")[:, :count]
    kept = np.take_along_axis(weights, bones, 1)
    return bones, kept / kept.sum(1, keepdims=True)


def strongest_weights(weights: Float[np.ndarray, "V J"], count: int) -> Float[np.ndarray, "V J"]:
    """The weights of the `strongest_bones` of each vertex, and zeros for all others."""
    few = np.zeros_like(weights)
    np.put_along_axis(few, *strongest_bones(weights, count), 1)
    return few
