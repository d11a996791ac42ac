"""Errors of benchmarks."""

from lfgpu.errors import LfgpuError


class BenchmarkError(LfgpuError):
    """A case, a backend, a file or an option that cannot be used."""
