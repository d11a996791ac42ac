"""Pipelines that stay in memory for the next light field of their kind."""

from __future__ import annotations

import atexit
import ctypes
import math
import sys
import threading
from hashlib import sha256
from typing import Any

import numpy as np

from lfgpu.data import DepthResult, LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.footprint import parse_memory
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.pipeline import DepthPipeline, Progress

_LIMIT = 2**31  # bytes


class Resident:
    """Pipelines for light fields of several kinds, of which `most` and about `limit` bytes stay between estimates.

    An estimate takes the pipeline of its kind away meanwhile: other threads that need one make their own. A result does
    not depend on the light fields before.
    """

    def __init__(self, most: int, limit: float = math.inf) -> None:
        self._most, self._limit = most, limit
        self._kept: dict[Any, tuple[DepthPipeline, int]] = {}  # those used last at the end
        self._lock = threading.Lock()

    @property
    def bytes(self) -> int:
        """The memory of the pipelines that wait for a light field, about."""
        with self._lock:
            return sum(size for _, size in self._kept.values())

    def limit(self, limit: float) -> None:
        """Set the bytes that pipelines may take; those used longest ago are freed until they take no more."""
        with self._lock:
            self._limit = limit
            self._free(self._most)

    def free(self) -> None:
        """Free all pipelines."""
        with self._lock:
            self._free(0)

    def estimate(
        self,
        lf: LightField,
        measured: Measured | None = None,
        *,
        disparity_range: tuple[float, float] | None = None,
        on_progress: Progress | None = None,
        **options: Any,
    ) -> DepthResult:
        """Estimate a light field; `options` are further keywords of `DepthPipeline`, which can be compared."""
        masks = None if lf.valid is None else sha256(np.packbits(lf.valid).tobytes()).digest()
        kind = lf.views.shape, lf.views.dtype.str, lf.scale, lf.positions.tobytes(), lf.reference_index, masks
        key = (*kind, *options.items())
        with self._lock:
            pipeline, _ = self._kept.pop(key, (None, 0))
            if pipeline is None:
                self._free(self._most - 1)  # its memory first
        try:
            if pipeline is None:
                pipeline = DepthPipeline(lf, measured=measured, disparity_range=disparity_range, **options)
            else:
                pipeline.take(lf, measured=measured, disparity_range=disparity_range)
            result = pipeline.estimate(on_progress=on_progress)
        except LightFieldError:  # which says something of the views, and nothing of the pipeline
            if pipeline is not None:
                self._put_back(key, pipeline)
            raise
        if not self._put_back(key, pipeline):
            del pipeline
            _return_memory()
        return result

    def _put_back(self, key: Any, pipeline: DepthPipeline) -> bool:
        """Keep a pipeline, if it is not larger than the limit; tell whether it is kept."""
        size = pipeline.let_go()
        with self._lock:
            if is_kept := size <= self._limit:
                self._kept[key] = pipeline, size
            self._free(self._most)
        return is_kept

    def _free(self, most: int) -> None:
        """Free the pipelines used longest ago, until so many are left and they keep to the limit."""
        before = len(self._kept)
        while self._kept and (len(self._kept) > most or sum(size for _, size in self._kept.values()) > self._limit):
            del self._kept[next(iter(self._kept))]
        if len(self._kept) < before:
            _return_memory()


def _return_memory() -> None:
    """Return the memory of dropped pipelines to the system: glibc keeps it, in pieces too small for the next one."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:
        trim(0)


KEPT = Resident(most=4, limit=_LIMIT)
"""The pipelines that `estimate_depth` keeps."""

atexit.register(KEPT.free)  # before the libraries that hold the devices go


def set_kept_memory(limit: str | float) -> None:
    """Set the memory that `estimate_depth` may keep for the next light field of the same kind.

    A light field of the same size, stored type, cameras and parameters as one before finds its memory allocated, and on
    a GPU all work recorded. What was used longest ago is freed first. Results do not depend on it.

    Parameters
    ----------
    limit
        Memory on all devices together, as "8GiB", "500MB" or a number of bytes. 0 frees all and keeps nothing. At the
        start of a process it is "2GiB".

    Raises
    ------
    LightFieldError
        If `limit` is no size.

    Examples
    --------
    >>> lfgpu.set_kept_memory(0)
    >>> lfgpu.kept_memory()
    0
    >>> lfgpu.set_kept_memory("2GiB")
    """
    KEPT.limit(0 if limit == 0 else parse_memory(limit))


def kept_memory() -> int:
    """Return the bytes that `estimate_depth` keeps on all devices for the next light field, about.

    Examples
    --------
    >>> lfgpu.kept_memory()
    0
    """
    return KEPT.bytes
