"""What goes wrong, said in one sentence."""

from lfgpu.errors import LfgpuError


class BenchmarkError(LfgpuError):
    """A case, a backend, a file or an option is not what it has to be."""
