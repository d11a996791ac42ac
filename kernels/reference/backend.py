"""All operations of the reference backend under one roof: this module is its `KernelSet`."""

import numpy as np

from .memory import devices, field, image, numpy, zeros, zeros_image
from .nlm import nlm_laplacian, nlm_neighbors, nlm_weights
from .splat import data_term, splat, splat_jvp, splat_transpose, splat_vjp
from .structure_tensor import structure_tensor
from .vector import axpby, clamp, copy, dot, multiply

name = "reference"
dtype = np.float64

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
