"""Submissions to the HCI 4D Light Field Benchmark, a map and a runtime for each of its scenes; and its masks of
regions.
"""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfgpu.errors import LightFieldError
from lfgpu.io.atomic import atomic_folder
from lfgpu.io.images import read_mask
from lfgpu.io.pfm import write_pfm

SCENES = (
    *("backgammon", "dots", "pyramids", "stripes"),
    *("boxes", "cotton", "dino", "sideboard"),
    *("bedroom", "bicycle", "herbs", "origami"),
)
"""The scenes of the benchmark: stratified, training, test."""
SIZE = (512, 512)
REGIONS = ("discontinuities", "planes", "smooth_surfaces", "fine_surrounding", "fine")
"""The names of its masks."""

_MASK_PLACES = ("", "evaluation_masks")
_MASK_NAMES = ("mask_{}_lowres.png", "mask_{}.png")


def write_submission(
    out: str | os.PathLike[str], results: Mapping[str, tuple[NDArray[np.float32], float]]
) -> tuple[str, ...]:
    """Write disp_maps/SCENE.pfm and runtimes/SCENE.txt, all or nothing; returns the scenes that a submission lacks.

    `results` are (disparity [512, 512], seconds) by the name of the scene. To be sent, the contents of the folder are
    zipped.
    """
    for scene, (disparity, seconds) in results.items():
        if scene not in SCENES:
            raise LightFieldError(f"{scene!r} is no scene of the benchmark; it has {', '.join(SCENES)}.")
        if disparity.shape != SIZE:
            raise LightFieldError(
                f"the map of {scene} is {disparity.shape[1]} x {disparity.shape[0]}; the benchmark takes 512 x 512."
            )
        undefined = int((~np.isfinite(disparity)).sum())
        if undefined:
            raise LightFieldError(
                f"the map of {scene} is undefined in {undefined} pixels; the benchmark takes numbers only: fill them."
            )
        if not 0 < seconds < float("inf"):
            raise LightFieldError(f"the runtime of {scene} must be a positive number of seconds, not {seconds}.")
    with atomic_folder(out) as folder:
        for name in ("disp_maps", "runtimes"):
            (folder / name).mkdir()
        for scene, (disparity, seconds) in results.items():
            write_pfm(folder / "disp_maps" / f"{scene}.pfm", disparity)
            (folder / "runtimes" / f"{scene}.txt").write_text(f"{seconds:.6f}\n", encoding="ascii")
    return tuple(scene for scene in SCENES if scene not in results)


def read_region_masks(folder: Path) -> dict[str, NDArray[np.bool_]]:
    """Read the masks of regions that a scene has, bool [y, x] by name; LightFieldError if one is damaged."""
    found = {}
    for region in REGIONS:
        places = (folder / place / name.format(region) for place in _MASK_PLACES for name in _MASK_NAMES)
        file = next((file for file in places if file.is_file()), None)
        if file is not None:
            found[region] = read_mask(file)
    return found
