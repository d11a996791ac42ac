"""All operations of the Warp backend under one roof: this module is its `KernelSet`."""

import numpy as np

from . import recording, streaming
from .alignment import alignment
from .boundaries import refine_boundaries
from .confidence import evidence, judge, line_mean, unevenness
from .conjugate import conjugate_step
from .control import asking, capture, is_deterministic, kernel_cache, repeat
from .cost_volume import add_reduced, least_costs, nlm_average, winner_takes_all
from .edges import edge_weights
from .lbfgs import lbfgs
from .memory import devices, field, image, number, numpy, scalar, upload, zeros, zeros_image
from .nlm import nlm_laplacian, nlm_neighbors, nlm_weights
from .nlm_regression import nlm_on_surface, nlm_plane, nlm_ratio
from .occlusion import splat_z_buffered, visible, z_buffered_data_term
from .plane_sweep import plane_sweep
from .range_search import details, distinct_minimum, shrink, side_costs
from .resampling import resample
from .residuals import residuals
from .semi_global import semi_global
from .sharing import shared
from .smoothing import reduce_views, smooth_views
from .splat import data_term, seen_by_reference, splat, splat_jvp, splat_transpose, splat_vjp
from .structure_tensor import keep_more_coherent, structure_tensor
from .vector import axpby, clamp, copy, divide, dot, fill, multiply, ratio, select, threshold
from .views import intensities, line_of_views, normalization
from .z_buffer import z_buffer

name = "warp"
compiles = True
dtype = np.float32

__all__ = [
    "add_reduced",
    "alignment",
    "asking",
    "axpby",
    "capture",
    "clamp",
    "compiles",
    "conjugate_step",
    "copy",
    "data_term",
    "details",
    "devices",
    "distinct_minimum",
    "divide",
    "dot",
    "dtype",
    "edge_weights",
    "evidence",
    "field",
    "fill",
    "image",
    "intensities",
    "is_deterministic",
    "judge",
    "keep_more_coherent",
    "kernel_cache",
    "lbfgs",
    "least_costs",
    "line_mean",
    "line_of_views",
    "multiply",
    "name",
    "nlm_average",
    "nlm_laplacian",
    "nlm_neighbors",
    "nlm_on_surface",
    "nlm_plane",
    "nlm_ratio",
    "nlm_weights",
    "normalization",
    "number",
    "numpy",
    "plane_sweep",
    "ratio",
    "recording",
    "reduce_views",
    "refine_boundaries",
    "repeat",
    "resample",
    "residuals",
    "scalar",
    "seen_by_reference",
    "select",
    "semi_global",
    "shared",
    "shrink",
    "side_costs",
    "smooth_views",
    "splat",
    "splat_jvp",
    "splat_transpose",
    "splat_vjp",
    "splat_z_buffered",
    "streaming",
    "structure_tensor",
    "threshold",
    "unevenness",
    "upload",
    "visible",
    "winner_takes_all",
    "z_buffer",
    "z_buffered_data_term",
    "zeros",
    "zeros_image",
]
