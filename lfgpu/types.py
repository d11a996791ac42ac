"""The contract between the host side and the kernels: array aliases and the operations that a backend is made of.

Shapes are written [n, y, x, c]: view, row, column, channel. Disparities are in pixels per view step, larger is nearer;
offsets are (du, dv) in view steps; intensities lie in [0, 1] (stored ones times `scale`).
"""
