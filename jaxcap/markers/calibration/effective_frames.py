"""The number of frames with the information of one with independent errors.

Residuals of markers on skin last: those of a frame are nearly those of the next one. Frames that count as
independent would give bone lengths far too small deviations. The number of independent ones is estimated from the
autocorrelation of all residuals (Geyer, Practical Markov Chain Monte Carlo, 1992).
"""

import numpy as np
from jaxtyping import Bool, Float

#: share of the frames that a correlation may last
MAX_LAG_SHARE = 0.25


def correlation_time(residuals: Float[np.ndarray, "F M 3"], seen: Bool[np.ndarray, "F M"]) -> float:
    """Estimate how many successive frames have the information of one, at least 1.

    `residuals` of each marker are in the frame of its bone; their means are subtracted, as a marker's place on its bone is
    unknown. Every marker counts by its own variance. The sum of the autocorrelation ends where two successive values are no longer
    positive together.
    """
    count = len(residuals)
    lags = max(2, int(MAX_LAG_SHARE * count))
    size = 1 << (count + lags - 1).bit_length()
    shown = seen[..., None].astype(float)
    number = np.maximum(shown.sum(0), 1.0)
    away = np.where(seen[..., None], residuals - (residuals * shown).sum(0) / number, 0.0)
    variance = (away**2).sum(0) / number
    away = away / np.sqrt(np.maximum(variance, 1e-16))
    waves, there = np.fft.rfft(away, size, axis=0), np.fft.rfft(shown[..., 0], size, axis=0)
    products = np.fft.irfft((np.abs(waves) ** 2).sum((1, 2)), size)[:lags]
    pairs = 3 * np.fft.irfft((np.abs(there) ** 2).sum(1), size)[:lags]
    correlation = products / np.maximum(pairs, 1.0)
    correlation = correlation / max(correlation[0], 1e-12)
    both = correlation[1:-1:2] + correlation[2::2]
    end = int(np.argmax(both <= 0)) if (both <= 0).any() else len(both)
    return float(max(1.0, 1.0 + 2.0 * both[:end].sum()))
