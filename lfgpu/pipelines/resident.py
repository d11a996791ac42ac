"""`Resident`: a pipeline that stays in memory while light fields of one kind come."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.pipeline import DepthPipeline


class Resident:
    """Latest pipeline, which serves the next light field if it is of the same kind and range and noise are known.

    Then a result does not depend on the light fields before. Any other light field gets a pipeline of its own.
    """

    def __init__(self) -> None:
        self._key: Any = None
        self._pipeline: DepthPipeline | None = None

    def estimate(
        self, lf: LightField, measured: Measured | None = None, *, captured: bool = False, **options: Any
    ) -> DepthResult:
        """Estimate a light field.

        Parameters
        ----------
        lf, measured
            The light field, and its range and noise; default None: they are not known.
        captured
            True: a pipeline that stays captures its work on a GPU, which concerns all threads of the process. Default
            False.
        options
            Further keywords of `DepthPipeline`.
        """
        masks = None if lf.valid is None else lf.valid.tobytes()
        views = lf.views.shape, lf.views.dtype.str, lf.scale, lf.positions.tobytes(), lf.reference_index, masks
        key = views, measured, options
        if self._pipeline is None or measured is None or key != self._key:
            self._pipeline = None  # frees its memory first
            self._pipeline, self._key = DepthPipeline(lf, measured=measured, **options), key
            return self._pipeline.estimate()
        self._pipeline.upload(lf.views)
        if not captured:
            result = self._pipeline.estimate()
        else:
            self._pipeline.run()
            result = self._pipeline.result()
        return replace(result, name=lf.name, geometry=lf.geometry)


__all__ = ["Resident"]
