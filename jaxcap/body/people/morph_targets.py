"""Morph targets: displacements of one mesh and its joints by sex, age, weight, muscle and height."""

import functools
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Integer
from scipy.optimize import brentq

#: age in years at which each age target has weight one
AGES = {"child": 10.0, "young": 25.0, "old": 90.0}
#: unit of the stored displacements, a tenth of a millimetre as in MakeHuman's files, metres
DISPLACEMENT_UNIT = 1e-4


class MorphTargets(NamedTuple):
    """A mesh with its bones, and T targets that displace both.

    The weight of a target is the product of the weights of all states in its name, such as
    `female young averagemuscle maxweight` (MakeHuman's macro targets, as in `macro.json`).
    """

    #: metres
    vertices: Float[np.ndarray, "V 3"]
    #: heads and tails of the bones, metres
    joints: Float[np.ndarray, "J 2 3"]
    target_states: np.ndarray
    #: in units of `DISPLACEMENT_UNIT`
    target_vertices: Integer[np.ndarray, "T V 3"]
    #: metres
    target_joints: Float[np.ndarray, "T J 2 3"]


class Traits(NamedTuple):
    """Traits of a person: `sex` from 0 (female) to 1 (male), `age` in years, `weight` and `muscle` from 0
    to 1.

    `stature` goes from -1 (MakeHuman's shortest) over 0 (that of sex and age) to 1 (tallest).
    """

    sex: float
    age: float
    weight: float
    muscle: float
    stature: float = 0.0


def state_weights(traits: Traits) -> dict[str, float]:
    """Compute the weight of each state for a person: linear between the states of one trait."""
    return {
        **_interpolate_states(traits.sex, {"female": 0.0, "male": 1.0}),
        **_interpolate_states(traits.age, AGES),
        **_interpolate_states(traits.weight, {"minweight": 0.0, "averageweight": 0.5, "maxweight": 1.0}),
        **_interpolate_states(traits.muscle, {"minmuscle": 0.0, "averagemuscle": 0.5, "maxmuscle": 1.0}),
        "minheight": max(-traits.stature, 0.0),
        "maxheight": max(traits.stature, 0.0),
    }


def _interpolate_states(value: float, positions: dict[str, float]) -> dict[str, float]:
    knots = list(positions.values())
    return {
        state: float(np.interp(value, knots, peak))
        for state, peak in zip(positions, np.eye(len(knots)), strict=True)
    }


def apply_morphs(
    morphs: MorphTargets, traits: Traits
) -> tuple[Float[np.ndarray, "V 3"], Float[np.ndarray, "J 2 3"]]:
    """Compute vertices and ends of the bones of one person, metres."""
    present = state_weights(traits)
    vertices, joints = morphs.vertices.astype(float), morphs.joints.astype(float)
    for target, states in enumerate(morphs.target_states):
        weight = np.prod([present[state] for state in str(states).split()])
        if weight > 0:
            vertices += weight * DISPLACEMENT_UNIT * morphs.target_vertices[target]
            joints += weight * morphs.target_joints[target]
    return vertices, joints


def fit_stature(morphs: MorphTargets, traits: Traits, height: float) -> Traits:
    """Find the stature of a person that is `height` metres tall, to a micrometre.

    **Raises:** `ValueError` with one sentence when no stature reaches it.
    """

    @functools.cache
    def tall(stature: float) -> float:
        return float(np.ptp(apply_morphs(morphs, traits._replace(stature=stature))[0][:, 1]))

    shortest, tallest = tall(-1.0), tall(1.0)
    if not shortest <= height <= tallest:
        raise ValueError(
            f"The height of a human is {height} m; for this sex, age, weight and muscle, give "
            f"a number from {shortest:.2f} to {tallest:.2f} m."
        )
    stature: Any = brentq(lambda stature: tall(stature) - height, -1.0, 1.0, xtol=1e-7)
    return traits._replace(stature=float(stature))
