"""The reference backend: NumPy in float64, readable, no tricks; the truth that the others are held against."""

from lfgpu.types import KernelSet

from . import backend

KERNELS: KernelSet = backend
