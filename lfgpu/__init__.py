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

_HOMES = {
    "BackendError": "errors",
    "BackendInfo": "_backends",
    "Config": "config",
    "DepthPipeline": "pipelines.pipeline",
    "DepthResult": "data.result",
    "DepthStream": "pipelines.stream",
    "DisparityMap": "data.result",
    "Explanation": "cameras",
    "FrameDroppedError": "pipelines.stream_result",
    "FrameGroup": "pipelines.grouper",
    "FrameGrouper": "pipelines.grouper",
    "Geometry": "data.geometry",
    "GroundTruth": "data.lightfield",
    "LfgpuError": "errors",
    "LightField": "data.lightfield",
    "LightFieldError": "errors",
    "PRESETS": "methods",
    "PointCloud": "data.points",
    "Reason": "cameras",
    "Rectifier": "pipelines.rectifier",
    "RenderedView": "viz.rendering",
    "Renderer": "viz.rendering",
    "StreamResult": "pipelines.stream_result",
    "TemporalPrior": "methods.temporal_prior",
    "Viewer": "viewer",
    "ViewsResult": "data.views_result",
    "all_in_focus": "viz.refocusing",
    "describe_backends": "_backends",
    "estimate_all_views": "pipelines.all_views",
    "estimate_depth": "pipelines.estimate",
    "evaluate": "metrics",
    "explain": "cameras",
    "export_pipeline": "pipelines.export",
    "fill_unknown": "data.filling",
    "get_threads": "threads",
    "judged": "pipelines.verdict",
    "kept_memory": "pipelines.resident",
    "list_backends": "_backends",
    "load": "io",
    "point_cloud": "data.points",
    "read": "io",
    "reasons": "cameras",
    "refocus": "viz.refocusing",
    "render_view": "viz.rendering",
    "save": "io",
    "set_kept_memory": "pipelines.resident",
    "set_threads": "threads",
    "to_xarray": "io.labelled",
    "write_report": "reports.report",
}

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
_hooks.html = _later("lfgpu.viz.notebook", "html")
_hooks.explanation_html = _later("lfgpu.reports.report", "explanation_html")


def __dir__() -> list[str]:
    return sorted(__all__)
