"""How well a centre is known: the paper's bound by the arc swept, and the covariance."""

import numpy as np
from jaxtyping import Float

#: frames that arcs are measured on
ARC_FRAMES = 150
#: the share of a trajectory's extremes that is not trusted
TAIL = 0.01


def swept_arc(track: Float[np.ndarray, "F 3"], centre: Float[np.ndarray, "3"]) -> float:
    """The largest angle between two places of a marker as seen from the centre, radians, but for the
    1 % greatest."""
    track = track[np.unique(np.linspace(0, len(track) - 1, min(ARC_FRAMES, len(track))).astype(int))]
    away = track - centre
    lengths = np.linalg.norm(away, axis=1)
    away = away[lengths > 1e-9] / lengths[lengths > 1e-9, None]
    if len(away) < 2:
        return 0.0
    # from the chord, which is exact at small angles where the cosine is not
    chords = np.linalg.norm(away[:, None] - away[None], axis=-1)
    reach = np.sort(chords, axis=1)[:, -max(1, round(TAIL * len(away)))]
    return 2 * float(np.arcsin(np.clip(0.5 * np.quantile(reach, 1 - TAIL), 0, 1)))


def arc_bound(distances: Float[np.ndarray, "F"], swept: float) -> float:
    """The bound on the precision of a centre towards the marker's arc, metres (Silaghi et al. 1998).

    A centre moved by `e` towards the middle of an arc of the angle `swept` changes the distance of
    the arc's ends and of its middle by `e cos(swept / 2)` and `e`, so distances that vary by half a
    range `d` cannot tell centres apart that are nearer than `d / (1 - cos(swept / 2))`. The
    paper's formula is lost; this is what its text says.
    """
    half = 0.5 * float(np.diff(np.quantile(distances, [0.025, 0.975]))[0])
    return half / max(1 - np.cos(0.5 * min(swept, np.pi)), 1e-12)


def independent_share(residuals: Float[np.ndarray, "F D"]) -> float:
    """How many of the frames count as independent, as a share: skin slides alike in like poses, so
    that frames that follow each other err alike. Initial positive sequence of the autocorrelation
    (Geyer 1992)."""
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


def principal(
    covariance: Float[np.ndarray, "3 3"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Standard deviations, least first, and their directions, one a row."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.sqrt(np.maximum(values, 0.0)), vectors.T
