"""All operations of the Taichi backend under one roof: this module is its `KernelSet`."""

import numpy as np

from .memory import field, image, numpy, zeros, zeros_image
from .nlm import nlm_laplacian, nlm_neighbors, nlm_weights
from .runtime import devices
from .splat import data_term, splat, splat_jvp, splat_transpose, splat_vjp
from .structure_tensor import structure_tensor
from .vector import axpby, clamp, copy, dot, multiply

name = "taichi"
dtype = np.float32

__all__ = [
    "axpby",
    "clamp",
    "copy",
    "data_term",
    "devices",
    "dot",
    "dtype",
    "field",
    "image",
    "multiply",
    "name",
    "nlm_laplacian",
    "nlm_neighbors",
    "nlm_weights",
    "numpy",
    "splat",
    "splat_jvp",
    "splat_transpose",
    "splat_vjp",
    "structure_tensor",
    "zeros",
    "zeros_image",
]
