"""The Taichi backend, the alternative to Warp: the same operations in float32, on CPUs and on CUDA."""

import os
import warnings

from lfgpu.contract import KernelSet

os.environ.setdefault("ENABLE_TAICHI_HEADER_PRINT", "False")  # Taichi prints a banner when it is imported
with warnings.catch_warnings():  # and uses what Python is about to drop
    warnings.simplefilter("ignore", DeprecationWarning)
    from . import backend

KERNELS: KernelSet = backend
