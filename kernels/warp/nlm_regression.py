"""Sums with non-local-means weights that also depend on a map: a ratio, a plane; `kernels/reference` says which."""

from typing import Any

import warp as wp

from .nlm import over_windows, window_on
from .pixels import Field, Volume, pixelwise
from .vector import given

_FILES = "nlm.h", "nlm.cuh"


def nlm_ratio(
    weights: Any,
    guide: Any,
    numerator: Any,
    denominator: Any,
    *,
    window: int,
    support: float,
    floor: Any,
    ratio_out: Any,
) -> None:
    fields = [weights, guide, numerator, denominator]
    over_windows(_FILES, "divide_sums", fields, window, ratio_out, numbers=[support, *given(floor)])


def nlm_plane(
    weights: Any, values: Any, certainty: Any, *, window: int, support: float, ridge: float, plane_out: Any
) -> None:
    fields = [weights, values, certainty]
    over_windows(_FILES, "fit_planes", fields, window, plane_out, numbers=[support, ridge])


@pixelwise("lfgpu_nlm_on_surface")
def _weigh_on_surface(
    n: int,
    y: int,
    x: int,
    weights: Volume,
    guide: Field,
    half_window: wp.array(dtype=wp.vec2i),
    weaken: float,
    weights_out: Volume,
):
    step = half_window[n]
    qy = y + step[0]
    qx = x + step[1]
    weight = float(0.0)
    if qy < guide.shape[0] and qx >= 0 and qx < guide.shape[1]:
        apart = guide[qy, qx] - guide[y, x]
        weight = weights[n, y, x] / (1.0 + apart * apart * weaken)
    weights_out[n, y, x] = weight


def nlm_on_surface(weights: Any, guide: Any, *, window: int, support: float, weights_out: Any) -> None:
    steps = window_on(window, guide.device.alias)
    _weigh_on_surface(weights, guide, steps, 1 / support**2, weights_out)
