"""The joint distribution of stature and the lengths of the limbs of adults."""

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from ...geometry.linear import pseudo_inverse

#: segments of limbs, by the joints at their ends on the left
LIMBS = {
    "upper arm": ("LeftArm", "LeftForeArm"),
    "forearm": ("LeftForeArm", "LeftHand"),
    "thigh": ("LeftUpLeg", "LeftLeg"),
    "shank": ("LeftLeg", "LeftFoot"),
}
#: mean lengths between joint centres, as shares of stature: de Leva (1996), tables 1 to 4, means of women and men
#: (thigh: men, as the women's hip centre is far below all later estimates). His shank of 0.2525 is longer than in ANSUR II, whose lateral
#: epicondyles and malleoli differ in height by 0.243 of stature, 0.010 more than the joints of the embedded human: this is the mean of both
SHARES = {"upper arm": 0.160, "forearm": 0.153, "thigh": 0.2425, "shank": 0.243}
#: the same of the embedded human of mean traits, whose arms are shorter
HUMAN_SHARES = {"upper arm": 0.140, "forearm": 0.1425, "thigh": 0.2458, "shank": 0.239}
#: mean stature of adults, metres, and relative standard deviation (women and men of ANSUR II, Gordon and others 2014)
STATURE, STATURE_SPREAD = 1.69, 0.054
#: relative standard deviations of the lengths of the limbs at all statures, and correlations of stature and these lengths, of as many women as
#: men: computed from the public data of ANSUR II (1,986 women and 4,082 men: acromion to radiale, radiale to stylion, trochanterion to
#: the lateral epicondyle, and from there to the lateral malleolus)
LENGTH_SPREADS = (0.065, 0.080, 0.076, 0.064)
CORRELATIONS = (
    (1.00, 0.87, 0.84, 0.77, 0.74),
    (0.87, 1.00, 0.81, 0.72, 0.77),
    (0.84, 0.81, 1.00, 0.73, 0.72),
    (0.77, 0.72, 0.73, 1.00, 0.59),
    (0.74, 0.77, 0.72, 0.59, 1.00),
)


def covariance_of_logarithms() -> Float[np.ndarray, "5 5"]:
    """Compute the covariance of the logarithms of stature and of the lengths of the limbs of adults."""
    spreads = np.array([STATURE_SPREAD, *LENGTH_SPREADS])
    return np.array(CORRELATIONS) * np.outer(spreads, spreads)


def human_means() -> Float[np.ndarray, "5"]:
    """Compute the logarithms of the mean stature of adults, metres, and of the lengths of the limbs of the embedded human of this stature."""
    return math.log(STATURE) + np.log([1.0, *(HUMAN_SHARES[name] for name in LIMBS)])


def differences_of_means() -> Float[np.ndarray, "5"]:
    """Compute the logarithms of how much longer the limbs are in surveys than those of the embedded human of the same stature."""
    return np.log([1.0, *(SHARES[name] / HUMAN_SHARES[name] for name in LIMBS)])


def condition_normal(
    mean: Float[np.ndarray, "N"],
    covariance: Float[np.ndarray, "N N"],
    values: Float[np.ndarray, "N"],
    variances: Float[np.ndarray, "N"],
) -> tuple[Float[np.ndarray, "N"], Float[np.ndarray, "N N"]]:
    """Condition normal numbers on observed `values` with errors of these `variances`; NaN where a number is not observed."""
    known = np.flatnonzero(np.isfinite(values))
    across = covariance[:, known]
    gain = across @ pseudo_inverse(
        covariance[np.ix_(known, known)] + np.diag(variances[known]), symmetric=True
    )
    return mean + gain @ (values - mean)[known], covariance - gain @ across.T


def length_given_others(name: str, lengths: Mapping[str, float]) -> tuple[float, float]:
    """Compute the median length of a limb, metres, and its relative standard deviation, of adults with the others' `lengths`."""
    found, covariance = _given_lengths({limb: length for limb, length in lengths.items() if limb != name})
    index = 1 + list(LIMBS).index(name)
    return math.exp(found[index]), math.sqrt(covariance[index, index])


def stature_of_limbs(lengths: Mapping[str, float]) -> float:
    """Compute the median stature, metres, of adults with limbs of these lengths."""
    return math.exp(_given_lengths(lengths)[0][0])


def improbability(name: str, lengths: Mapping[str, float]) -> float:
    """Compute by how many deviations a limb is longer than those of adults with the other `lengths`, negative if it is shorter."""
    usual, spread = length_given_others(name, lengths)
    return math.log(lengths[name] / usual) / spread


def _given_lengths(
    lengths: Mapping[str, float],
) -> tuple[Float[np.ndarray, "5"], Float[np.ndarray, "5 5"]]:
    """Condition the logarithms of stature and of all limbs on the lengths of some.

    Their means are half-way between those of surveys and of the embedded human, where fits begin, with half of the difference as deviation.
    """
    values = np.log([math.nan, *(lengths.get(limb, math.nan) for limb in LIMBS)])
    half = 0.5 * differences_of_means()
    return condition_normal(
        human_means() + half, covariance_of_logarithms() + np.diag(half**2), values, np.zeros(len(values))
    )
