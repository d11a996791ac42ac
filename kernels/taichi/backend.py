"""The operations of the Taichi backend under one roof: this module is its `KernelSet`."""

import numpy as np

from .alignment import alignment, z_buffer
from .boundaries import refine_boundaries
from .choice import choose, compare_maps
from .confidence import evidence, judge, line_mean, unevenness
from .conjugate import conjugate_step
from .control import asking, capture, is_deterministic, kernel_cache, prepare, repeat
from .convolution import convolution
from .cost_volume import add_reduced, least_costs, nlm_average, winner_takes_all
from .edges import edge_weights
from .facets import facets, planes
from .lbfgs import lbfgs
from .measuring import quantile, window_grain
from .memory import clear, field, image, number, numpy, read, scalar, shared, upload, within, zeros, zeros_image
from .nlm import nlm_laplacian, nlm_neighbors, nlm_weights
from .nlm_regression import nlm_on_surface, nlm_plane, nlm_ratio
from .occlusion import splat_z_buffered
from .peak import judge_peak, peak
from .plane_sweep import plane_sweep
from .range_search import agreeing_disparity, details, distinct_minimum, shrink, side_costs
from .resampling import resample
from .residuals import residuals
from .runtime import devices
from .sectors import brightness, fold, sector_costs
from .semi_global import semi_global
from .smoothing import reduce_views, smooth_views
from .splat import data_term, seen_by_reference
from .structure_tensor import keep_more_coherent, structure_tensor
from .sums import dot
from .vector import axpby, clamp, copy, divide, fill, multiply, ratio, select, threshold
from .views import intensities, line_of_views, normalization

name = "taichi"
compiles = True
dtype = np.float32
streaming = None
recording = changing = None
