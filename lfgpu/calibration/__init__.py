"""Cameras as they are: how well they fit together, and how they become parallel ones in a plane."""

from lfgpu.calibration.judge import Explanation, explain, residual_pictures

__all__ = ["Explanation", "explain", "residual_pictures"]
