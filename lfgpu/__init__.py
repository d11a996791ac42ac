"""lfgpu: disparity, confidence and metric depth from 4D light fields, by matching or by synthesis.

    lf = lfgpu.read("path/to/light field")
    result = lfgpu.estimate_depth(lf)
    result.disparity                         # float32 [y, x], pixels per view step, larger is nearer

Importing lfgpu starts no device and loads no backend; names are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from lfgpu.data import hooks as _hooks

if TYPE_CHECKING:
    from lfgpu._backends import BackendInfo, describe_backends, list_backends
    from lfgpu.cameras import Explanation, Reason, explain, reasons
    from lfgpu.config import Config
    from lfgpu.data.filling import fill_unknown
    from lfgpu.data.geometry import Geometry
    from lfgpu.data.lightfield import GroundTruth, LightField
    from lfgpu.data.points import PointCloud, point_cloud
    from lfgpu.data.result import DepthResult, DisparityMap
    from lfgpu.data.views_result import ViewsResult
    from lfgpu.errors import BackendError, LfgpuError, LightFieldError
    from lfgpu.io import load, read, save
    from lfgpu.io.labelled import to_xarray
    from lfgpu.methods import PRESETS
    from lfgpu.methods.temporal_prior import TemporalPrior
    from lfgpu.metrics import evaluate
    from lfgpu.pipelines.all_views import estimate_all_views
    from lfgpu.pipelines.estimate import estimate_depth
    from lfgpu.pipelines.export import export_pipeline
    from lfgpu.pipelines.grouper import FrameGroup, FrameGrouper
    from lfgpu.pipelines.pipeline import DepthPipeline
    from lfgpu.pipelines.rectifier import Rectifier
    from lfgpu.pipelines.resident import kept_memory, set_kept_memory
    from lfgpu.pipelines.stream import DepthStream
    from lfgpu.pipelines.stream_result import FrameDroppedError, StreamResult
    from lfgpu.pipelines.verdict import judged
    from lfgpu.reports.report import write_report
    from lfgpu.threads import get_threads, set_threads
    from lfgpu.viewer import Viewer
    from lfgpu.viz.refocusing import all_in_focus, refocus
    from lfgpu.viz.rendering import RenderedView, Renderer, render_view

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

__all__ = [
    "PRESETS",
    "BackendError",
    "BackendInfo",
    "Config",
    "DepthPipeline",
    "DepthResult",
    "DepthStream",
    "DisparityMap",
    "Explanation",
    "FrameDroppedError",
    "FrameGroup",
    "FrameGrouper",
    "Geometry",
    "GroundTruth",
    "LfgpuError",
    "LightField",
    "LightFieldError",
    "PointCloud",
    "Reason",
    "Rectifier",
    "RenderedView",
    "Renderer",
    "StreamResult",
    "TemporalPrior",
    "Viewer",
    "ViewsResult",
    "all_in_focus",
    "describe_backends",
    "estimate_all_views",
    "estimate_depth",
    "evaluate",
    "explain",
    "export_pipeline",
    "fill_unknown",
    "get_threads",
    "judged",
    "kept_memory",
    "list_backends",
    "load",
    "point_cloud",
    "read",
    "reasons",
    "refocus",
    "render_view",
    "save",
    "set_kept_memory",
    "set_threads",
    "to_xarray",
    "write_report",
]


if not TYPE_CHECKING:  # or every misspelt name would be Any

    def __getattr__(name: str) -> Any:
        if name == "__version__":
            from lfgpu.machine import version_of

            return version_of("lfgpu") or "not installed"
        if name not in _HOMES:
            raise AttributeError(f"module 'lfgpu' has no attribute {name!r}")
        return getattr(importlib.import_module(f"lfgpu.{_HOMES[name]}"), name)


def _later(home: str, name: str) -> Callable[..., Any]:
    """Return a function that is imported when it is first called."""
    return lambda *arguments, **options: getattr(importlib.import_module(home), name)(*arguments, **options)


_hooks.save = _later("lfgpu.io", "save")
_hooks.html = _later("lfgpu.reports.notebook", "html")


def __dir__() -> list[str]:
    return sorted(__all__)
