"""Weights that are small beside steps in brightness; `kernels/reference/edges.py` says which."""

from typing import Any

from .memory import pixel_type
from .native_code import kernel
from .threads import launch_rows
from .vector import given


def _kernel(channels: int, reach: int, on_cpu: bool) -> Any:
    file = "edges.h" if on_cpu else "edges.cuh"
    return kernel(file, "weigh_edges", Pixel=pixel_type(channels), CHANNELS=channels, REACH=reach)


def weigh_edges(image: Any, weight: float, contrast: Any, reach: int, weights_out: Any) -> None:
    """`weight` times `edge_weights`."""
    weigh = _kernel(image.dtype._length_, reach, image.device.is_cpu)
    launch_rows(weigh, [image, weight, *given(contrast)], weights_out)


def edge_weights(image: Any, *, contrast: Any, reach: int, weights_out: Any) -> None:
    weigh_edges(image, 1.0, contrast, reach, weights_out)
