"""The same light field by every backend that runs here: how long each takes, and how far the maps are apart.

python examples/compare_backends.py
"""

import numpy as np

import lfgpu
from lfgpu import scenes


def main(size: tuple[int, int] = (64, 80)) -> dict[str, lfgpu.DepthResult]:
    lf = scenes.make("relief", grid=(5, 5), size=size)
    results = {}
    for info in lfgpu.describe_backends():
        if info.problem is not None:
            print(f"{info.name:10} {info.problem}")
            continue
        results[info.name] = lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), backend=info.name)
    for name, result in results.items():
        apart = np.median(np.abs(result.disparity - results["reference"].disparity))
        print(f"{name:10} {result.seconds:6.2f} s on {result.device}, {apart:.1e} px from the reference")
    return results


if __name__ == "__main__":
    main()
