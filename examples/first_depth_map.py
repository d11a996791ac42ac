"""A first depth map: a light field in, a picture and a number for each pixel out.

    python examples/first_depth_map.py [FOLDER]

FOLDER is a light field of yours; without it a scene of lfgpu is made, whose truth is known.
"""

import sys

import numpy as np

import lfgpu
from lfgpu import scenes
from lfgpu.viz.pictures import write_disparity


def main(
    folder: str | None = None, out: str = "disparity.png", size: tuple[int, int] = (192, 256)
) -> lfgpu.DepthResult:
    lf = lfgpu.read(folder) if folder else scenes.make("boxes", grid=(7, 7), size=size)
    result = lfgpu.estimate_depth(lf)  # a GPU if there is one
    low, high = np.nanmin(result.disparity), np.nanmax(result.disparity)  # NaN is unknown
    print(f"{lf.name}: {low:.2f} to {high:.2f} px per view step, larger is nearer")
    if result.depth is not None:
        print(f"{np.nanmin(result.depth):.2f} to {np.nanmax(result.depth):.2f} m")
    truth = lf.reference_truth()
    if truth is not None:
        print(lfgpu.evaluate(result.disparity, truth.disparity, mask=truth.mask))
    write_disparity(result.disparity, out, name=lf.name)
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
