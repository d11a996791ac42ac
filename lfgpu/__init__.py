"""lfgpu: disparity, confidence and metric depth from 4D light fields, by analysis through synthesis.

    lf = lfgpu.read("path/to/light field")
    result = lfgpu.estimate_depth(lf)
    result.disparity                         # float32 [y, x], pixels per view step, larger is nearer

Importing lfgpu starts no device and loads no backend; names are loaded when they are first used.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfgpu._backends import BackendInfo, describe_backends, list_backends
    from lfgpu.all_views import ViewsResult, estimate_all_views
    from lfgpu.config import PRESETS, Config
    from lfgpu.depth import DepthPipeline, estimate_depth
    from lfgpu.errors import BackendError, LfgpuError, LightFieldError
    from lfgpu.export import export_pipeline
    from lfgpu.geometry import Geometry
    from lfgpu.io import load, read, save
    from lfgpu.lightfield import GroundTruth, LightField
    from lfgpu.metrics import evaluate
    from lfgpu.points import PointCloud, point_cloud
    from lfgpu.refocusing import all_in_focus, refocus
    from lfgpu.render import RenderedView, Renderer, render_view
    from lfgpu.result import DepthResult, DisparityMap
    from lfgpu.stream import DepthStream, FrameDroppedError, StreamResult
    from lfgpu.temporal import TemporalPrior
    from lfgpu.threads import get_threads, set_threads
    from lfgpu.viewer import Viewer

_HOMES = {
    "BackendError": "errors",
    "BackendInfo": "_backends",
    "Config": "config",
    "DepthPipeline": "depth",
    "DepthResult": "result",
    "DepthStream": "stream",
    "DisparityMap": "result",
    "FrameDroppedError": "stream",
    "Geometry": "geometry",
    "GroundTruth": "lightfield",
    "LfgpuError": "errors",
    "LightField": "lightfield",
    "LightFieldError": "errors",
    "PRESETS": "config",
    "PointCloud": "points",
    "RenderedView": "render",
    "Renderer": "render",
    "StreamResult": "stream",
    "TemporalPrior": "temporal",
    "Viewer": "viewer",
    "ViewsResult": "all_views",
    "all_in_focus": "refocusing",
    "describe_backends": "_backends",
    "estimate_all_views": "all_views",
    "estimate_depth": "depth",
    "evaluate": "metrics",
    "export_pipeline": "export",
    "get_threads": "threads",
    "list_backends": "_backends",
    "load": "io",
    "point_cloud": "points",
    "read": "io",
    "refocus": "refocusing",
    "render_view": "render",
    "save": "io",
    "set_threads": "threads",
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
    "FrameDroppedError",
    "Geometry",
    "GroundTruth",
    "LfgpuError",
    "LightField",
    "LightFieldError",
    "PointCloud",
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
    "export_pipeline",
    "get_threads",
    "list_backends",
    "load",
    "point_cloud",
    "read",
    "refocus",
    "render_view",
    "save",
    "set_threads",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'lfgpu' has no attribute {name!r}")
    return getattr(importlib.import_module(f"lfgpu.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
