"""All operations of the Warp backend under one roof: this module is its `KernelSet`."""

import numpy as np

from .alignment import alignment, nearest_surface
from .control import capture, is_deterministic, repeat
from .cost_volume import lowest, nlm_average
from .lbfgs import lbfgs
from .memory import devices, field, image, number, numpy, scalar, upload, zeros, zeros_image
from .nlm import nlm_laplacian, nlm_neighbors, nlm_on_surface, nlm_ratio, nlm_weights
from .occlusion import occluding_data_term, splat_occluding, visible
from .outlines import unmix
from .plane_sweep import plane_sweep
from .residuals import residuals
from .semi_global import semi_global
from .sharing import shared
from .splat import data_term, seen_by_reference, splat, splat_jvp, splat_transpose, splat_vjp
from .structure_tensor import keep_more_coherent, structure_tensor
from .vector import at_least, axpby, choose, clamp, copy, divide, dot, fill, multiply, ratio
from .views import intensities, line_of_views, normalization

name = "warp"
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
