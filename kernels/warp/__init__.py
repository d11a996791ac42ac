"""The Warp backend, the default: the same operations as the reference, in float32, on CPUs and on CUDA."""

from lfgpu.types import KernelSet

from . import backend

KERNELS: KernelSet = backend
