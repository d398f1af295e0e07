"""Phenotypes of the body model Anny: the weights of its targets, and a population of people."""

from collections.abc import Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

#: states of each phenotype, at even distances from 0 to 1 (Anny, `PHENOTYPE_VARIATIONS`)
STATES: dict[str, tuple[str, ...]] = {
    "gender": ("male", "female"),
    "age": ("baby", "child", "young", "old"),
    "muscle": ("minmuscle", "averagemuscle", "maxmuscle"),
    "weight": ("minweight", "averageweight", "maxweight"),
    "height": ("minheight", "maxheight"),
    "proportions": ("idealproportions", "uncommonproportions"),
    "cupsize": ("mincup", "averagecup", "maxcup"),
    "firmness": ("minfirmness", "averagefirmness", "maxfirmness"),
}
#: phenotypes of which only the ratios count
ANCESTRIES = ("african", "asian", "caucasian")
#: all phenotypes, and those that Anny varies by default
PHENOTYPES = (*STATES, *ANCESTRIES)
DEFAULT_PHENOTYPES = ("gender", "age", "muscle", "weight", "height", "proportions")
#: value of a phenotype that is not given
DEFAULT = 0.5

#: number of sampled people, a power of two
NUM_PEOPLE = 2048
#: ages in years at values of `age`, and ages of the population (Anny, `MorphologicalAgeMapping` and `SimpleShapeDistribution`)
YEARS, AGES = (0.0, 1.0, 4.0, 11.0, 16.0, 18.0, 64.0, 110.0), (0.0, 0.05, 0.215, 0.415, 0.67, 0.77, 0.83, 1.0)
OLDEST = 90.0
#: parameters of the beta distributions of `height` at the first values of `AGES`, of males and of females, which Anny's authors
#: fitted to the growth of children (Anny, `ConditionalHeightDistribution`)
HEIGHTS = (
    ((21.6, 52.0, 22.1, 13.4, 16.5), (58.6, 57.4, 45.9, 22.1, 25.7)),
    ((29.5, 66.3, 31.8, 21.3, 13.7), (96.7, 74.5, 59.5, 24.0, 25.8)),
)


class Target(NamedTuple):
    """A file of displacements, and the states whose weights are multiplied to its weight."""

    #: path below `targets`, without suffix
    path: str
    states: tuple[str, ...]
    #: some targets of breasts do not exist, as nothing is displaced
    optional: bool = False


def list_targets() -> list[Target]:
    """List the targets of all combinations of states."""
    found = []
    common = product(*(STATES[name] for name in ("gender", "age", "muscle", "weight")))
    for states in common:
        joined = "-".join(states)
        found.append(Target(f"macrodetails/universal-{joined}", states))
        for height in STATES["height"]:
            found.append(Target(f"macrodetails/height/{joined}-{height}", (*states, height)))
        if states[1] == "baby":
            continue
        for shape in STATES["proportions"]:
            found.append(Target(f"macrodetails/proportions/{joined}-{shape}", (*states, shape)))
        if states[0] == "female":
            for more in product(STATES["cupsize"], STATES["firmness"]):
                found.append(Target(f"breast/{joined}-{'-'.join(more)}", (*states, *more), optional=True))
    for states in product(ANCESTRIES, STATES["gender"], STATES["age"]):
        found.append(Target(f"macrodetails/{'-'.join(states)}", states))
    return found


def target_weights(
    targets: list[Target], phenotypes: Mapping[str, Float[np.ndarray, "N"]], num_people: int
) -> Float[np.ndarray, "N T"]:
    """Compute the weights of targets for N people: products of the weights of their states.

    The weight of a state is linear between it and its neighbours. The three ancestries are divided by their sum.
    """
    given = {name: phenotypes.get(name, np.full(num_people, DEFAULT)) for name in PHENOTYPES}
    weights: dict[str, np.ndarray] = {}
    for name, states in STATES.items():
        knots = np.linspace(0.0, 1.0, len(states))
        for state, peak in zip(states, np.eye(len(states)), strict=True):
            weights[state] = np.interp(given[name], knots, peak)
    shares = np.stack([given[name] for name in ANCESTRIES])
    total = shares.sum(0)
    shares = np.where(total > 0, shares / np.where(total > 0, total, 1.0), 1.0 / len(ANCESTRIES))
    weights |= dict(zip(ANCESTRIES, shares, strict=True))
    return np.stack([np.prod([weights[state] for state in target.states], 0) for target in targets], 1)


def sample_population(varied: tuple[str, ...]) -> dict[str, Float[np.ndarray, "N"]]:
    """Sample the phenotypes of a population: ages of 0 to 90 years, heights by age and gender, the others uniformly.

    It follows Anny's `SimpleShapeDistribution`, but for uniform `weight` and `muscle`. Samples are those of a Sobol sequence, so
    that they are the same on every computer, and coefficients keep their meaning.
    """
    names = [name for name in PHENOTYPES if name in varied]
    sequence = scipy.stats.qmc.Sobol(len(PHENOTYPES), scramble=False)
    points = sequence.random_base2(NUM_PEOPLE.bit_length() - 1) + 0.5 / NUM_PEOPLE
    found = {name: points[:, PHENOTYPES.index(name)] for name in names}
    found["age"] = np.interp(OLDEST * found["age"], YEARS, AGES)
    alpha, beta = (
        np.where(
            found["gender"] <= 0.5,
            *(np.interp(found["age"], AGES[: len(sex[which])], sex[which]) for sex in HEIGHTS),
        )
        for which in (0, 1)
    )
    found["height"] = scipy.stats.beta.ppf(found["height"], alpha, beta)
    return found
