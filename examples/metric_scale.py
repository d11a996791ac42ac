"""A dense map of another tool on the scale of lfgpu: metric depth also where a light field shows nothing.

    python examples/metric_scale.py OUT/result.npz OTHER.npy SCALED.npz

OTHER.npy is float32 [y, x] of the reference view, larger is nearer, in any unit: networks that estimate depth from one
picture give inverse depth up to scale and shift. Both are fitted over the pixels whose confidence is high.
"""

import sys
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import lfgpu

SURE = 0.9  # the confidence from which on a pixel takes part
STEPS = 30  # of the fit, which counts pixels that contradict the others less in each


def on_scale(other: NDArray[np.floating], result: lfgpu.DepthResult, sure: float = SURE) -> NDArray[np.float32]:
    """Return scale * other + shift, the disparity that is nearest to that of the result in the mean of |error|."""
    if other.shape != result.disparity.shape:
        raise ValueError(f"the map must have the shape {result.disparity.shape} of the result, found {other.shape}")
    known = (result.confidence >= sure) & np.isfinite(other) & np.isfinite(result.disparity)
    if known.sum() < 100:
        raise ValueError(f"only {known.sum()} pixels have a confidence of {sure:g} or more: no scale can be fitted")
    values = np.stack([other[known], np.ones(known.sum())], axis=1).astype(np.float64)
    target = result.disparity[known].astype(np.float64)
    weight = np.ones(len(target))
    for _ in range(STEPS):
        root = np.sqrt(weight)[:, None]
        fit = np.linalg.lstsq(root * values, root[:, 0] * target, rcond=None)[0]
        weight = 1 / np.maximum(np.abs(values @ fit - target), 1e-3)
    print(f"scale {fit[0]:.4g}, shift {fit[1]:.4g}, median error {np.median(np.abs(values @ fit - target)):.3f} px")
    return (fit[0] * other + fit[1]).astype(np.float32)


def main(result: str, other: str, scaled: str) -> lfgpu.DisparityMap:
    solved = lfgpu.load(result)
    assert isinstance(solved, lfgpu.DepthResult), f"{result} holds no result"
    disparity = on_scale(np.load(other), solved)
    map_ = replace(solved.map, disparity=disparity, confidence=None, uncertainty=None)
    map_.save(scaled)
    return map_


if __name__ == "__main__":
    main(*sys.argv[1:4])
