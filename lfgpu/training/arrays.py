"""Arrays of cameras drawn at random: grids, crosses, stars, rows, and scattered ones."""

from __future__ import annotations

import numpy as np

from lfgpu.contract import Float64Array

MOST_VIEWS = 40
"""Views beside the reference that are kept of a larger array."""


def draw_array(rng: np.random.Generator) -> Float64Array:
    """Draw the offsets (du, dv) of the views beside the reference, [n, 2]; the farthest has max(|du|, |dv|) = 1."""
    kind = rng.choice(["grid", "star", "cross", "row", "scattered", "corner"], p=[0.3, 0.25, 0.15, 0.1, 0.12, 0.08])
    side = int(rng.choice([1, 2, 3, 4, 8], p=[0.12, 0.18, 0.2, 0.4, 0.1]))
    steps = np.arange(-side, side + 1)
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2).astype(float)
    du, dv = grid.T
    if kind == "star":
        grid = grid[(du == 0) | (dv == 0) | (np.abs(du) == np.abs(dv))]
    elif kind == "cross":
        grid = grid[(du == 0) | (dv == 0)]
    elif kind == "row":
        grid = grid[dv == 0]
        grid = grid + rng.uniform(-1, 1) * side * np.array([1.0, 0.0]) * (rng.random() < 0.3)
        grid = grid[:, ::-1] if rng.random() < 0.5 else grid
    elif kind == "scattered":
        count = int(rng.integers(6, 25))
        grid = rng.uniform(-1, 1, (count, 2)) * side
    elif kind == "corner":
        grid = grid + rng.integers(-side, side + 1, 2)
    grid = grid[np.abs(grid).max(1) > 1e-3]
    if len(grid) > MOST_VIEWS:
        # Every other view, as the squares of one colour on a chessboard, or as many as may be kept.
        board = grid[np.rint(grid).sum(1) % 2 == 0]
        grid = board if len(board) <= MOST_VIEWS else grid[rng.permutation(len(grid))[:MOST_VIEWS]]
    return grid / np.abs(grid).max()
