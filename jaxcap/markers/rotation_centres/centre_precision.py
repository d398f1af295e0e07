"""The precision of a centre: the paper's bound by the swept arc, and the covariance."""

import numpy as np
from jaxtyping import Float

from ...geometry.sampling import even_indices

#: number of frames that arcs are measured on
ARC_FRAMES = 150
#: share of a trajectory's extremes that is ignored
TRIMMED_FRACTION = 0.01


def swept_arc(track: Float[np.ndarray, "F 3"], centre: Float[np.ndarray, "3"]) -> float:
    """Compute the largest angle between two marker positions as seen from the centre, radians.

    The 1 % extremes are left out.
    """
    track = track[even_indices(len(track), ARC_FRAMES)]
    away = track - centre
    lengths = np.linalg.norm(away, axis=1)
    away = away[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    if len(away) < 2:
        return 0.0
    # from the chord, which is accurate at small angles; the cosine is not
    chords = np.linalg.norm(away[:, None] - away[None], axis=-1)
    reach = np.sort(chords, axis=1)[:, -max(1, round(TRIMMED_FRACTION * len(away)))]
    return 2 * float(np.arcsin(np.clip(0.5 * np.quantile(reach, 1 - TRIMMED_FRACTION), 0, 1)))


def arc_bound(distances: Float[np.ndarray, "F"], swept: float) -> float:
    """Compute the bound on a centre's precision towards the marker's arc, metres (Silaghi et al. 1998).

    A centre that moves by `e` towards the middle of an arc of the angle `swept` changes its distance to the
    ends of the arc by `e cos(swept / 2)`, and to the middle by `e`. So distances with half a range `d`
    cannot separate centres that are closer than `d / (1 - cos(swept / 2))`. The paper's formula is lost;
    this one follows its text.
    """
    half = 0.5 * float(np.diff(np.quantile(distances, [0.025, 0.975]))[0])
    return half / max(1 - np.cos(0.5 * min(swept, np.pi)), 1e-12)


def independent_frame_fraction(residuals: Float[np.ndarray, "F D"]) -> float:
    """Estimate the share of independent frames from the autocorrelation of their residuals.

    Skin slides alike in similar poses, so that consecutive frames have similar errors. Method: initial
    positive sequence (Geyer 1992).
    """
    count = len(residuals)
    centred = residuals - residuals.mean(0)
    power = float((centred**2).sum())
    if power <= 0 or count < 8:
        return 1.0
    spectrum = np.fft.rfft(centred, 2 * count, axis=0)
    auto = np.fft.irfft(np.abs(spectrum) ** 2, axis=0)[:count].sum(1) / power
    pairs = auto[1 : count - 1 : 2] + auto[2:count:2]
    stop = int(np.argmax(pairs <= 0)) if (pairs <= 0).any() else len(pairs)
    return float(np.clip(1 / (1 + 2 * max(pairs[:stop].sum(), 0.0)), 6 / count, 1.0))


def principal_deviations(
    covariance: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Compute standard deviations, ascending, and their directions, one a row."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.sqrt(np.maximum(values, 0.0)), vectors.T
