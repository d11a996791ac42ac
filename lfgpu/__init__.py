"""lfgpu: disparity, confidence and metric depth from 4D light fields, by matching or by synthesis.

    lf = lfgpu.read("path/to/light field")
    result = lfgpu.estimate_depth(lf)
    result.disparity                         # float32 [y, x], pixels per view step, larger is nearer

Importing lfgpu starts no device and loads no backend; names are loaded when they are first used.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lfgpu import hooks as _hooks

if TYPE_CHECKING:
    from lfgpu._backends import (
        BackendInfo as BackendInfo,
        describe_backends as describe_backends,
        list_backends as list_backends,
    )
    from lfgpu.cameras import Explanation as Explanation, explain as explain
    from lfgpu.cameras.reasons import Reason as Reason, reasons as reasons
    from lfgpu.config import Config as Config
    from lfgpu.data.filling import fill_unknown as fill_unknown
    from lfgpu.data.geometry import Geometry as Geometry
    from lfgpu.data.lightfield import GroundTruth as GroundTruth, LightField as LightField
    from lfgpu.data.points import PointCloud as PointCloud, point_cloud as point_cloud
    from lfgpu.data.result import DepthResult as DepthResult, DisparityMap as DisparityMap
    from lfgpu.data.views_result import ViewsResult as ViewsResult
    from lfgpu.errors import BackendError as BackendError, LfgpuError as LfgpuError, LightFieldError as LightFieldError
    from lfgpu.io import load as load, read as read, save as save
    from lfgpu.io.labelled import to_xarray as to_xarray
    from lfgpu.methods import PRESETS as PRESETS
    from lfgpu.methods.temporal_prior import TemporalPrior as TemporalPrior
    from lfgpu.metrics import evaluate as evaluate
    from lfgpu.pipelines.all_views import estimate_all_views as estimate_all_views
    from lfgpu.pipelines.estimate import estimate_depth as estimate_depth
    from lfgpu.pipelines.export import export_pipeline as export_pipeline
    from lfgpu.pipelines.grouper import FrameGroup as FrameGroup, FrameGrouper as FrameGrouper
    from lfgpu.pipelines.pipeline import DepthPipeline as DepthPipeline
    from lfgpu.pipelines.rectifier import Rectifier as Rectifier
    from lfgpu.pipelines.resident import kept_memory as kept_memory, set_kept_memory as set_kept_memory
    from lfgpu.pipelines.stream import DepthStream as DepthStream
    from lfgpu.pipelines.stream_result import FrameDroppedError as FrameDroppedError, StreamResult as StreamResult
    from lfgpu.pipelines.verdict import judged as judged
    from lfgpu.reports.report import write_report as write_report
    from lfgpu.threads import get_threads as get_threads, set_threads as set_threads
    from lfgpu.viewer import Viewer as Viewer
    from lfgpu.viz.refocusing import all_in_focus as all_in_focus, refocus as refocus
    from lfgpu.viz.rendering import RenderedView as RenderedView, Renderer as Renderer, render_view as render_view

    __version__: str
    """The version of the package that is installed."""

_NAMES = {
    "_backends": ("BackendInfo", "describe_backends", "list_backends"),
    "cameras": ("Explanation", "Reason", "explain", "reasons"),
    "config": ("Config",),
    "data.filling": ("fill_unknown",),
    "data.geometry": ("Geometry",),
    "data.lightfield": ("GroundTruth", "LightField"),
    "data.points": ("PointCloud", "point_cloud"),
    "data.result": ("DepthResult", "DisparityMap"),
    "data.views_result": ("ViewsResult",),
    "errors": ("BackendError", "LfgpuError", "LightFieldError"),
    "io": ("load", "read", "save"),
    "io.labelled": ("to_xarray",),
    "methods": ("PRESETS",),
    "methods.temporal_prior": ("TemporalPrior",),
    "metrics": ("evaluate",),
    "pipelines.all_views": ("estimate_all_views",),
    "pipelines.estimate": ("estimate_depth",),
    "pipelines.export": ("export_pipeline",),
    "pipelines.grouper": ("FrameGroup", "FrameGrouper"),
    "pipelines.pipeline": ("DepthPipeline",),
    "pipelines.rectifier": ("Rectifier",),
    "pipelines.resident": ("kept_memory", "set_kept_memory"),
    "pipelines.stream": ("DepthStream",),
    "pipelines.stream_result": ("FrameDroppedError", "StreamResult"),
    "pipelines.verdict": ("judged",),
    "reports.report": ("write_report",),
    "threads": ("get_threads", "set_threads"),
    "viewer": ("Viewer",),
    "viz.refocusing": ("all_in_focus", "refocus"),
    "viz.rendering": ("RenderedView", "Renderer", "render_view"),
}
"""Modules, and what `lfgpu` has from each."""
_HOMES = {name: home for home, names in _NAMES.items() for name in names}

if not TYPE_CHECKING:  # or every misspelt name would be Any
    __all__ = sorted(_HOMES)

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from lfgpu.machine import version_of

            return version_of("lfgpu") or "not installed"
        if name not in _HOMES:
            if name.startswith("_") or importlib.util.find_spec(f"lfgpu.{name}") is None:
                raise AttributeError(f"module 'lfgpu' has no attribute {name!r}")
            return importlib.import_module(f"lfgpu.{name}")
        return getattr(importlib.import_module(f"lfgpu.{_HOMES[name]}"), name)


def _later(home: str, name: str) -> Callable[..., Any]:
    """Return a function that is imported when it is first called."""
    return lambda *arguments, **options: getattr(importlib.import_module(home), name)(*arguments, **options)


_hooks.save = _later("lfgpu.io", "save")
_hooks.html = _later("lfgpu.reports.notebook", "html")


def __dir__() -> list[str]:
    return sorted(_HOMES)
