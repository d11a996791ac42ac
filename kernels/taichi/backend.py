"""All operations of the Taichi backend under one roof: this module is its `KernelSet`."""

import numpy as np

from .alignment import alignment, nearest_surface
from .control import capture, is_deterministic, repeat
from .cost_volume import lowest, nlm_average
from .lbfgs import lbfgs
from .memory import field, image, number, numpy, scalar, shared, upload, zeros, zeros_image
from .nlm import nlm_laplacian, nlm_neighbors, nlm_on_surface, nlm_ratio, nlm_weights
from .occlusion import occluding_data_term, splat_occluding, visible
from .outlines import unmix
from .plane_sweep import plane_sweep
from .residuals import residuals
from .runtime import devices
from .semi_global import semi_global
from .splat import data_term, seen_by_reference, splat, splat_jvp, splat_transpose, splat_vjp
from .structure_tensor import keep_more_coherent, structure_tensor
from .sums import dot
from .vector import at_least, axpby, choose, clamp, copy, divide, fill, multiply, ratio
from .views import intensities, line_of_views, normalization

name = "taichi"
dtype = np.float32

__all__ = [
    "alignment",
    "at_least",
    "axpby",
    "capture",
    "choose",
    "clamp",
    "copy",
    "data_term",
    "devices",
    "divide",
    "dot",
    "dtype",
    "field",
    "fill",
    "image",
    "intensities",
    "is_deterministic",
    "keep_more_coherent",
    "lbfgs",
    "line_of_views",
    "lowest",
    "multiply",
    "name",
    "nearest_surface",
    "nlm_average",
    "nlm_laplacian",
    "nlm_neighbors",
    "nlm_on_surface",
    "nlm_ratio",
    "nlm_weights",
    "normalization",
    "number",
    "numpy",
    "occluding_data_term",
    "plane_sweep",
    "ratio",
    "repeat",
    "residuals",
    "scalar",
    "seen_by_reference",
    "semi_global",
    "shared",
    "splat",
    "splat_jvp",
    "splat_occluding",
    "splat_transpose",
    "splat_vjp",
    "structure_tensor",
    "unmix",
    "upload",
    "visible",
    "zeros",
    "zeros_image",
]
