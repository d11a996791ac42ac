"""The Warp backend, the default: the same operations as the reference, in float32, on CPUs and on CUDA."""

from lfgpu.contract import KernelSet

from . import backend

KERNELS: KernelSet = backend
