"""Results that nobody estimated: what tests of files, pages and texts start from."""

from typing import Any

import numpy as np

from lfgpu.data.result import DepthResult
from lfgpu.methods import PRESETS


def made_result(disparity: np.ndarray, confidence: Any = 0.5, **fields: Any) -> DepthResult:
    """A result of `fast` with that map and confidence, and with `fields` in the place of what others do not look at."""
    usual = {"stages": {"sweep": disparity}, "position": (1.0, 1.0), "disparity_range": (-2.0, 2.0)}
    usual |= {"config": PRESETS["fast"], "status": "It stopped.", "converged": True, "trace": ()}
    usual |= {"timings": {"total": 1.0}, "backend": "warp", "device": "cpu", "versions": {"lfgpu": "0.1.0"}}
    confidence = np.broadcast_to(np.float32(confidence), disparity.shape).copy()
    return DepthResult(disparity, confidence, **(usual | fields))
