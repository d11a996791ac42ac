"""
A map and its error
===================

A view of the scene `boxes`, the estimated disparity, the exact truth, and their difference. All maps share one scale.
"""

import lfgpu
from lfgpu import scenes
from lfgpu.viz.figures import overview_figure

lf = scenes.make("boxes", grid=(7, 7), size=(144, 192))
result = lfgpu.estimate_depth(lf)
truth = lf.reference_truth().disparity

figure = overview_figure(lf.image(lf.reference_index), result.disparity, truth, title="boxes, 49 views", border=15)
