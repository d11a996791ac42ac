"""The device side: one package per backend, each with the same files and the same operations (`lfgpu.contract`)."""

if __name__ != "lfgpu.kernels":
    raise ImportError("the folder kernels/ is the package lfgpu.kernels: install lfgpu and import it by that name.")
