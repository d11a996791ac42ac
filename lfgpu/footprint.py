"""How much memory an estimate takes, from sizes alone; `tests/test_tiles.py` measures that it does."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from numbers import Real

from lfgpu.config import Config
from lfgpu.errors import LightFieldError
from lfgpu.lightfield import LightField
from lfgpu.matching import labels, used_views

_PROCESS = 500 * 2**20  # bytes: Python, the libraries and the compiled kernels
_CONTEXT = 640 * 2**20  # bytes: what a process takes of a GPU whatever the sizes, most of it before it has any array
_SLACK = 1.1  # what allocators round up, and small buffers
_ROOMS = 16  # slices that work on a CPU is cut into, some of which have room of their own
_BATCH = 16  # views that a GPU normalises at a time
_PLACES = 3  # places on a line of views that a structure tensor is summed over
_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12, "ki": 2**10, "mi": 2**20, "gi": 2**30, "ti": 2**40}


def parse_memory(value: str | float) -> int:
    """Bytes from a number of them or from text such as "8GiB", "500 MB" or "2g"; LightFieldError for anything else."""
    if isinstance(value, Real) and not isinstance(value, bool) and 1 <= float(value) < math.inf:
        return int(value)
    match = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*([kmgt]i?|)b?\s*", str(value).lower())
    size = int(float(match[1]) * _UNITS[match[2]]) if match and isinstance(value, str) else 0
    if size < 1:
        raise LightFieldError(f"max_memory must be a size such as 8GiB or 500MB, not {value!r}.")
    return size


@dataclass(frozen=True)
class Footprint:
    """Bytes that a `DepthPipeline` takes: so many for each pixel of a view, and so many besides."""

    per_pixel: float
    besides: int

    def bytes(self, height: int, width: int) -> int:
        """Of a pipeline for views of that size, the process or the context of the GPU included."""
        return self.besides + int(_SLACK * self.per_pixel * height * width)


def footprint(lf: LightField, bounds: tuple[float, float], config: Config, *, on_gpu: bool) -> Footprint:
    """What estimating light fields of one kind takes, the views of which are on disk.

    Parameters
    ----------
    lf
        A light field of that kind: its cameras, channels, stored type and whether it has masks count.
    bounds
        (low, high) of the disparities, pixels per view step.
    config
        All parameters.
    on_gpu
        Whether what is counted is the memory of a GPU, or that of the process that computes on a CPU.
    """
    channels, stored = lf.channels, lf.views.dtype.itemsize
    used = len(used_views(lf, config.sweep.views)) if config.method.name == "matching" else len(lf.views)
    views = used * channels * stored
    half_window = (config.prior.window**2 - 1) // 2
    weights = 2 * 4 * half_window + 4 * 3 * channels  # and what they are made from
    masks = 0 if lf.valid is None else 5 * used
    host = 0 if on_gpu else views + masks  # the tile as it was cut out
    besides = _CONTEXT if on_gpu else _PROCESS
    if config.method.name == "matching":
        padded = used * (4 if channels == 3 else 2) * stored  # a pixel with whether it is valid
        kept = views if not on_gpu else padded  # by the sweep
        volumes = 2 * 4 * labels(bounds, lf.offsets, config.sweep)[2]
        rooms = 0 if on_gpu else 2 * 4 * _ROOMS
        fields = 4 * (24 + 2 * channels)
        weights += 4 * half_window  # of the filling
        if config.matching.window != config.prior.window:
            weights += 2 * 4 * ((config.matching.window**2 - 1) // 2) + 4 * 3 * channels
        per_pixel = host + views + kept + padded + 4 * used + volumes + weights + rooms + fields + masks
        return Footprint(per_pixel, besides)
    solvers = 4 * 64 if on_gpu else 4 * 40  # pairs of steps that L-BFGS remembers, and what else it keeps
    if on_gpu:
        details = used * 2 * (channels + (4 if channels == 3 else 2))  # as they are and packed, in half precision
        batch = min(used, _BATCH) * (2 * 4 * channels + 3 * 4)  # of the normalisation
        lines = (len(lf.row()) + len(lf.column())) * channels * stored + 4 * _PLACES * 4 * channels
    else:
        details = 3 * used * 4 * channels
        batch, lines = 0, 2 * (len(lf.row()) + len(lf.column())) * 4 * channels
    return Footprint(host + views + details + 8 * used + batch + lines + weights + solvers + masks, besides)
