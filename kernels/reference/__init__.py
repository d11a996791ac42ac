"""The reference backend: NumPy in float64, readable, no tricks; the truth that the others are held against."""

from lfgpu.contract import KernelSet

from . import backend

KERNELS: KernelSet = backend
