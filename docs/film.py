"""The film of the site's first page: a scene seen from a moving camera, refocused, and its disparity map beside it.

python docs/film.py MY/LIGHT_FIELD    # writes docs/film.webp
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import lfgpu
from lfgpu.viz.colours import LOOKS, painted
from lfgpu.viz.panels import rgb
from lfgpu.viz.scales import scale_limits

FILM = Path(__file__).parent / "film.webp"
FRAMES, PAUSE = 36, 80  # frames of each half, milliseconds of each
_RADIUS = 3.0  # view steps: of the circle on which the camera moves
_SHARP = 0.12  # of the range: pixels as near to the focus are bright in the map
_GAP = 8  # pixels between both panels


def frames(lf: lfgpu.LightField) -> list[Image.Image]:
    """Draw the frames: once round a circle, then the focus from far to near and back."""
    maps = lfgpu.estimate_all_views(lf)
    render = lfgpu.Renderer(lf, maps)
    still = render(*_place(lf, 0.0, 0.0))
    limits = scale_limits(still.disparity)
    drawn = []
    for share in np.arange(FRAMES) / FRAMES:
        turn = 2 * np.pi * share
        view = render(*_place(lf, np.sin(turn), np.cos(turn)))
        drawn.append(_pair(view.image, _map(view.disparity, limits)))
    middle = 0.5 * (limits[0] + limits[1])
    for share in np.arange(FRAMES) / FRAMES:
        focus = middle - 0.4 * (limits[1] - limits[0]) * np.sin(2 * np.pi * share)
        sharp = np.exp(-(((still.disparity - focus) / (_SHARP * (limits[1] - limits[0]))) ** 2))
        light = (0.5 + 0.5 * sharp)[..., None]
        drawn.append(_pair(lfgpu.refocus(lf, focus), (_map(still.disparity, limits) * light).astype(np.uint8)))
    return drawn


def _place(lf: lfgpu.LightField, down: float, right: float) -> tuple[float, float]:
    u, v = lf.positions[lf.reference_index]
    return float(v + _RADIUS * down), float(u + _RADIUS * right)


def _map(disparity: NDArray[np.float32], limits: tuple[float, float]) -> NDArray[np.uint8]:
    return painted(disparity, LOOKS["disparity"].colours, limits)


def _pair(image: NDArray[np.float32], drawn: NDArray[np.uint8]) -> Image.Image:
    gap = np.full((len(drawn), _GAP, 3), 255, np.uint8)
    return Image.fromarray(np.concatenate([rgb(image, 1.0), gap, drawn], axis=1))


def main(folder: str) -> None:
    """Write the film."""
    first, *others = frames(lfgpu.read(folder))
    first.save(FILM, save_all=True, append_images=others, duration=PAUSE, loop=0, quality=72, method=6)
    print(f"{FILM}: {1 + len(others)} frames, {FILM.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1])
