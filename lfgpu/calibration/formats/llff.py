"""poses_bounds.npy of LLFF: a pose, a size, a focal length and two depths for each picture, ordered by their names.

A row is 3 x 5 numbers and the nearest and farthest depth. Columns are the camera's axes down, right and backwards in
the world, its centre, and (height, width, focal length).
"""

from pathlib import Path

import numpy as np

from lfgpu.calibration.cameras import Camera
from lfgpu.calibration.formats.entries import entries_of, numbers
from lfgpu.errors import LightFieldError
from lfgpu.io.numpy_file import load_arrays


def read_llff(path: Path) -> tuple[list[Camera], tuple[float, float]]:
    """Read the cameras, and the nearest and farthest depth of the scene."""
    rows = load_arrays(path, ("poses",))["poses"]
    if rows.ndim != 2 or rows.shape[1] != 17 or not len(rows):
        raise LightFieldError(f"{path} must hold 17 numbers for each picture, found shape {rows.shape}.")
    cameras = []
    with entries_of(path):
        for index, row in enumerate(rows := numbers(rows)):
            down, right, back, centre, (height, width, focal) = row[:15].reshape(3, 5).T
            rotation = np.stack([right, down, -back])
            cameras.append(
                Camera(
                    size=(round(height), round(width)),
                    focal_length=(float(focal), float(focal)),
                    principal_point=((width - 1) / 2, (height - 1) / 2),
                    rotation=rotation,
                    translation=-rotation @ centre,
                    name=f"picture {index}",
                )
            )
    return cameras, (float(rows[:, 15].min()), float(rows[:, 16].max()))
