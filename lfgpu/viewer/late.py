"""Modules that the viewer imports after the first pictures are drawn, and before any kernel is loaded.

To import and to load a kernel both parse Python, which two threads must not do at the same time.
"""

import importlib
import pkgutil
import threading

from lfgpu import methods
from lfgpu._backends import DEFAULT

_MODULES = (
    "lfgpu.viz.refocusing",
    f"lfgpu.kernels.{DEFAULT}",
    "lfgpu.pipelines.estimate",
    "lfgpu.calibration",  # an estimate looks at the cameras
    "lfgpu.io.views",
    "lfgpu.viewer.space",
    "viser",
    "trimesh",
    "rich.panel",
    "rich.table",
    "matplotlib",  # colours
)
_importing = threading.Lock()


def import_all() -> None:
    """Import these modules, unless that was done. Other callers wait meanwhile, so that they load no kernel yet."""
    with _importing:
        for name in (*_MODULES, *(one.name for one in pkgutil.walk_packages(methods.__path__, f"{methods.__name__}."))):
            importlib.import_module(name)
