"""Trust in a network: how often pixels of its maps are right, and how far off they are, from its distributions."""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from lfgpu.contract import Float64Array, peak_features

_LIMITS = 0.04, 0.12, 0.28, 0.56  # pixels in the farthest view
_TAIL = 2.0  # degrees of freedom of the errors


def fit_trust(
    probability: Float64Array, deviation: Float64Array, step: Float64Array, error: Float64Array
) -> tuple[Float64Array, Float64Array]:
    """Fit the weights of `KernelSet.judge_peak` to errors of maps.

    Parameters
    ----------
    probability, deviation
        Of each pixel, [n], as `KernelSet.peak` gives them; the deviation in units of `step`.
    step
        The distance of the disparities that were compared, pixels in the farthest view, [n].
    error
        The distance of the map from the truth, pixels in the farthest view, [n].

    Returns
    -------
    share [4], spread [3]
        Of the log odds that a pixel is right, by maximum likelihood over several limits; and of the logarithm of the
        variance, in steps, by that of Student's distribution, as a few errors are of any size.
    """
    features = peak_features(probability, deviation)
    right = [(np.log(limit / step), np.where(error < limit, 1.0, -1.0)) for limit in _LIMITS]
    steps = error / step

    def unlikely_share(weights: Float64Array) -> float:
        base = weights[:3] @ features
        return float(sum(np.logaddexp(0, -sign * (base + weights[3] * limit)).mean() for limit, sign in right))

    def unlikely_spread(weights: Float64Array) -> float:
        log_variance = weights @ features
        ratio = steps**2 * np.exp(-log_variance)
        return float((log_variance / 2 + (_TAIL + 1) / 2 * np.log1p(ratio / _TAIL)).mean())

    return _least(unlikely_share, 4), _least(unlikely_spread, 3)


def _least(function: object, count: int) -> NDArray[np.float64]:
    found: NDArray[np.float64] = minimize(function, np.zeros(count)).x
    return found
