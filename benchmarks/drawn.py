"""Light fields of the package drawn at random: scene, cameras, reference, size, range, noise and light.

Nobody chose them, so they show conditions that spoil maps and that nobody thought of.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from lfgpu import LightField, scenes

_SCENES = ("relief", "planes", "boxes", "bars", "textureless")
_GRIDS = ((9, 9), (7, 7), (5, 5), (3, 3), (2, 2), (11, 11), (4, 6), (3, 7), (1, 9), (9, 1), (1, 5))
_SIZES = ((160, 200), (240, 240), (320, 288), (200, 360))
_WIDTHS = (0.6, 1.5, 3.0, 5.0, 7.0)  # of the range of disparities, pixels per view step
_OFF_CENTRE = 2.0  # pixels per view step, by which the middle of a range is off 0 at most,
_IN_CENTRE = 0.4  # but this share of the ranges has it there
_NOISES = (0.0, 0.005, 0.01, 0.02)  # of a view, intensity
_CENTRAL = 0.7  # share of the light fields whose reference is the middle view
_BRIGHT = 0.7  # share of the light fields that are not dimmed,
_DIMMED = (0.1, 0.5)  # to this share of their light


def drawn(first: int, count: int) -> dict[str, Callable[[], LightField]]:
    """Return light fields of the seeds `first`, `first` + 1 and so on, by name, made when they are asked for."""
    return dict(_one(seed) for seed in range(first, first + count))


def _one(seed: int) -> tuple[str, Callable[[], LightField]]:
    random = np.random.default_rng(seed)
    scene = _SCENES[random.integers(len(_SCENES))]
    rows, columns = grid = _GRIDS[random.integers(len(_GRIDS))]
    size = _SIZES[random.integers(len(_SIZES))]
    width = _WIDTHS[random.integers(len(_WIDTHS))]
    centre = 0.0 if random.random() < _IN_CENTRE else random.uniform(-_OFF_CENTRE, _OFF_CENTRE)
    noise = _NOISES[random.integers(len(_NOISES))]
    reference = None if random.random() < _CENTRAL else (int(random.integers(rows)), int(random.integers(columns)))
    light = 1.0 if random.random() < _BRIGHT else random.uniform(*_DIMMED)
    channels = int(random.choice((1, 3)))
    name = f"{seed}-{scene}-{rows}x{columns}x{size[0]}x{size[1]}, noise {noise / light:.3f}"
    make = partial(
        scenes.make,
        scene,
        seed=seed,
        grid=grid,
        size=size,
        disparity_range=(centre - width / 2, centre + width / 2),
        noise=noise / light,
        reference=reference,
        dtype=np.float32,
        channels=channels,
    )
    return name, partial(_dimmed, make, light)


def _dimmed(make: Callable[[], LightField], light: float) -> LightField:
    lf = make()
    return replace(lf, views=lf.views * np.float32(light))
