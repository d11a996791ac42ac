"""The estimate that options ask for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfgpu._backends import backend_named
from lfgpu.cli import values
from lfgpu.cli.depth import Estimation

if TYPE_CHECKING:
    from lfgpu.config import Config


def asked_for(
    config: Config, disparity_range: str | None, backend: str, device: str | None, threads: int | None
) -> Estimation:
    """The estimate that options ask for; sets the threads of the CPU.

    LfgpuError if an option is wrong, or if the backend or the device is missing.
    """
    estimation = Estimation(config, values.parse_disparity_range(disparity_range), backend_named(backend), device)
    values.use_threads("--threads", threads)
    estimation.check_device()
    return estimation
