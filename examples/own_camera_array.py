"""Views from cameras of one's own: five of them, in no grid, whose places were measured.

python examples/own_camera_array.py
"""

import numpy as np

import lfgpu
from lfgpu import scenes


def recorded(size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """What cameras of one's own would deliver: uint8 [n, y, x, c], and where each stands, in metres [n, 2]."""
    lf = scenes.make("planes", grid=(5, 5), size=size)
    chosen = [lf.index_of(row, column) for row, column in ((2, 2), (2, 0), (2, 4), (0, 2), (4, 1))]
    views = (lf.views[chosen] * (255 * lf.scale)).astype(np.uint8)
    return views, lf.positions[chosen] * 0.05  # 5 cm from one camera to the next


def main(size: tuple[int, int] = (160, 200)) -> lfgpu.DepthResult:
    views, metres = recorded(size)
    baseline = 0.05  # any length will do as the unit of the positions: disparities are in pixels for one of it
    lf = lfgpu.LightField(
        views,
        metres / baseline,
        reference=0,
        geometry=lfgpu.Geometry(focal_length_px=600.0, baseline_m=baseline, focus_distance_m=2.0),
        name="five cameras",
    )
    result = lfgpu.estimate_depth(lf, disparity_range=(-2, 2))
    assert result.depth is not None  # the geometry is known
    sure = 100 * (result.confidence > 0.5).mean()
    print(f"{result.depth.min():.2f} to {result.depth.max():.2f} m, sure of {sure:.0f} % of the pixels")
    return result


if __name__ == "__main__":
    main()
