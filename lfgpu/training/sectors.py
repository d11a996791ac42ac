"""Costs by angular sector: how well the views on each side of the reference agree with it at a row of disparities.

The number and the arrangement of views are free: whatever there is, a pixel and disparity get SECTORS pairs of costs.
"""

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from lfgpu.contract import Float64Array

SECTORS = 8
"""Directions around the reference; a view lies in the one whose middle is nearest to the angle of its offset."""

CHANNELS = 2 * SECTORS

UNIT = 0.02
"""Difference in intensity from which costs grow like its logarithm."""

_SECTORS, _UNIT = wp.constant(SECTORS), wp.constant(UNIT)
_Costs = wp.types.vector(length=16, dtype=wp.float16)
_Sums = wp.types.vector(length=8, dtype=wp.float32)


@wp.func
def _look_up(views: wp.array4d(dtype=wp.vec3f), scene: int, n: int, x: float, y: float) -> wp.vec3f:
    """Interpolate a view at a place in its frame."""
    x0 = wp.min(int(x), views.shape[3] - 2)
    y0 = wp.min(int(y), views.shape[2] - 2)
    ax = x - float(x0)
    ay = y - float(y0)
    upper = views[scene, n, y0, x0] * (1.0 - ax) + views[scene, n, y0, x0 + 1] * ax
    lower = views[scene, n, y0 + 1, x0] * (1.0 - ax) + views[scene, n, y0 + 1, x0 + 1] * ax
    return upper * (1.0 - ay) + lower * ay


@wp.func
def _growth(difference: float) -> float:
    ratio = difference / _UNIT
    return 0.25 * wp.log(1.0 + ratio)


@wp.kernel(enable_backward=False)
def _sector_costs_kernel(
    views: wp.array4d(dtype=wp.vec3f),
    reference: wp.array3d(dtype=wp.vec3f),
    offsets: wp.array(dtype=wp.vec2f),
    starts: wp.array(dtype=int),
    first: wp.array3d(dtype=float),
    steps: wp.array(dtype=float),
    margin: int,
    costs_out: wp.array4d(dtype=_Costs),
):
    """Compute costs [b, l, y, x, CHANNELS] of `views` [b, n, y, x] at the disparities first[b, y, x] + l steps[b].

    Views are sorted by sector, sector s beginning at starts[s]; pixel (0, 0) of `reference` is (margin, margin) of
    each view. A view takes part where its place lies in its frame. The costs of a sector are the mean absolute
    difference of its views and the absolute value of their mean difference, each as 1/4 log(1 + cost / UNIT); those of
    sectors without any view are the means over the others, or 1 if there are none.
    """
    scene, label, y, x = wp.tid()
    d = first[scene, y, x] + float(label) * steps[scene]
    colour = reference[scene, y, x]
    single = _Sums()
    common = _Sums()
    there = _Sums()
    sum_single = float(0.0)
    sum_common = float(0.0)
    count = float(0.0)
    for s in range(_SECTORS):
        total = float(0.0)
        mean = wp.vec3f(0.0, 0.0, 0.0)
        seen = float(0.0)
        for n in range(starts[s], starts[s + 1]):
            vx = float(x + margin) - d * offsets[n][0]
            vy = float(y + margin) - d * offsets[n][1]
            if vx >= 0.0 and vy >= 0.0 and vx <= float(views.shape[3] - 1) and vy <= float(views.shape[2] - 1):
                difference = _look_up(views, scene, n, vx, vy) - colour
                total = total + wp.abs(difference[0]) + wp.abs(difference[1]) + wp.abs(difference[2])
                mean = mean + difference
                seen = seen + 1.0
        if seen > 0.0:
            single[s] = _growth(total / (3.0 * seen))
            common[s] = _growth((wp.abs(mean[0]) + wp.abs(mean[1]) + wp.abs(mean[2])) / (3.0 * seen))
            there[s] = 1.0
            sum_single = sum_single + single[s]
            sum_common = sum_common + common[s]
            count = count + 1.0
    if count > 0.0:
        sum_single = sum_single / count
        sum_common = sum_common / count
    else:
        sum_single = 1.0
        sum_common = 1.0
    costs = _Costs()
    for s in range(_SECTORS):
        costs[s] = wp.float16(wp.where(there[s] > 0.0, single[s], sum_single))
        costs[s + _SECTORS] = wp.float16(wp.where(there[s] > 0.0, common[s], sum_common))
    costs_out[scene, label, y, x] = costs


def order_of_sectors(offsets: Float64Array) -> tuple[NDArray[np.int64], list[int]]:
    """Indices that sort offsets [n, 2] by sector, and where each sector begins there, with the end."""
    angle = np.arctan2(offsets[:, 1], offsets[:, 0])
    sector = np.rint(angle / (2 * np.pi / SECTORS)).astype(int) % SECTORS
    order = np.argsort(sector, kind="stable")
    return order, [int(np.searchsorted(sector[order], s)) for s in range(SECTORS + 1)]


def warp_stream(device: str) -> wp.ScopedStream:
    """Let Warp work on the stream of PyTorch on a device."""
    if not device.startswith("cuda"):
        return wp.ScopedStream(None)
    return wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(torch.device(device))))


def sector_costs(
    views: torch.Tensor,
    reference: torch.Tensor,
    offsets: Float64Array,
    starts: list[int],
    *,
    margin: int,
    first: torch.Tensor,
    steps: torch.Tensor,
    count: int,
) -> torch.Tensor:
    """Compare views with their reference at the disparities first [b, y, x] + l steps [b], l < `count`.

    Parameters
    ----------
    views
        float32 [b, n, y, x, 3], in the order of `order_of_sectors`.
    reference
        float32 [b, y, x, 3], smaller than the views by `margin` pixels on each side.
    offsets, starts
        The offsets [n, 2] of the views, and where each sector begins among them.

    Returns
    -------
    torch.Tensor
        Costs [b, CHANNELS, count, y, x], channels last in memory.
    """
    device = str(views.device)
    scenes, height, width, _ = reference.shape
    costs = torch.empty((scenes, count, height, width, CHANNELS), dtype=torch.float16, device=views.device)
    with warp_stream(device):
        wp.launch(
            _sector_costs_kernel,
            dim=(scenes, count, height, width),
            inputs=[
                wp.from_torch(views.contiguous(), dtype=wp.vec3f),
                wp.from_torch(reference.contiguous(), dtype=wp.vec3f),
                wp.array(offsets.astype(np.float32), dtype=wp.vec2f, device=device),
                wp.array(np.array(starts, np.int32), dtype=int, device=device),
                wp.from_torch(first.contiguous()),
                wp.from_torch(steps.contiguous()),
                margin,
            ],
            outputs=[wp.from_torch(costs, dtype=_Costs)],
            device=device,
        )
    kind = views.device.type
    dtype = torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32
    return costs.permute(0, 4, 1, 2, 3).to(dtype)
