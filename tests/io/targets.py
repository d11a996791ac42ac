"""Files that the fuzzer damages: light fields in all formats, raw captures, outputs of lfgpu, calibrations."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lfgpu.calibration import rectify
from lfgpu.data import LightField
from lfgpu.io import read
from lfgpu.scenes import make
from tests.calibration import rigs
from tests.io.fields import SAMPLES, Sample, scene
from tests.io.lenslet_samples import Camera, capture, container, metadata, packed
from tests.io.outputs import OUTPUTS

_GRID, _SIZE = (3, 3), (36, 34)
_CAMERAS = 4


@dataclass(frozen=True)
class Target:
    """One kind of file."""

    write: Callable[[Path], Path]
    """Writes into a folder that exists; what to read."""
    read: Callable[[Path, np.random.Generator], Any]
    """Reads it in one of the ways in which it can be read."""


def _of_format(sample: Sample) -> Target:
    options = {**sample.options, "grid": _GRID} if "grid" in sample.options else sample.options

    def reading(path: Path, rng: np.random.Generator) -> LightField:
        given = options if rng.random() < 0.8 else {}
        told = sample.format if rng.random() < 0.7 or given else None
        return read(path, format=told, allow_missing=bool(rng.random() < 0.5), **given)

    return Target(lambda place: sample.write(scene(_GRID, _SIZE), place), reading)


def _pictures(suffix: str, **options: Any) -> Target:
    """Views in a format of pictures that no other sample has."""

    def write(place: Path) -> Path:
        for number, view in enumerate(scene((2, 2), _SIZE).views):
            Image.fromarray(view).save(place / f"view_{number // 2}_{number % 2}{suffix}", **options)
        return place

    return Target(write, lambda path, _: read(path))


def _raw(bits: int) -> Target:
    """A raw capture in a container of the first Lytro (12 bits) or of the Illum (10 bits)."""

    def write(place: Path) -> Path:
        views = make("planes", grid=(9, 9), size=(40, 42), disparity_range=(-0.6, 0.6), seed=3)
        mosaic = capture(views, Camera(size=(160, 168)), noise=0.005).raw
        black, white = (168, 4095) if bits == 12 else (64, 1023)
        stored = np.rint(black + mosaic * (white - black)).astype(np.uint16)
        data = container(packed(stored, bits), metadata(stored.shape, bits=bits), illum=bits == 10)
        (place / "IMG_0001.lfp").write_bytes(data)
        return place / "IMG_0001.lfp"

    return Target(write, lambda path, _: read(path))


def _calibration(write: rigs.Write) -> Target:
    """Calibrated cameras, and pictures that are rectified with them."""
    views = np.random.default_rng(0).integers(0, 255, (_CAMERAS, 24, 32, 1), np.uint8)
    pictures = LightField(views, np.stack([np.arange(_CAMERAS), np.zeros(_CAMERAS)], axis=1))
    cameras = rigs.rig(lens=(), alike=True) if write is rigs.as_llff else rigs.rig()
    return Target(partial(write, cameras), lambda path, _: rectify(pictures, calibration=path).light_field)


TARGETS: dict[str, Target] = {
    **{name: _of_format(sample) for name, sample in SAMPLES.items()},
    **{name: Target(output.write, lambda path, _, read=output.read: read(path)) for name, output in OUTPUTS.items()},  # type: ignore[misc]
    **{name: _calibration(write) for name, write in rigs.WRITERS.items()},
    "webp": _pictures(".webp", lossless=True),
    "ppm": _pictures(".ppm"),
    "raw-lytro": _raw(12),
    "raw-illum": _raw(10),
}
