"""The picture and the film of the viewer in the README and the pages: the page in headless Chromium.

lfgpu scene still_life -o still_life --grid 9x9 --size 384x384
python tests/viewer_picture.py still_life    # writes docs/viewer.png and docs/viewer.webp
"""

import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import browser
import numpy as np
from PIL import Image

import lfgpu

DOCS = Path(__file__).parents[1] / "docs"
SIZE = (1280, 700)
SHOWN = (1024, 560)  # pixels of the film
POINTS = 10  # that are clicked in the view, and focused on
TURNS = 10  # frames of the turning cloud
_WAIT = 6000  # ms: until the page has drawn all
_STEP = 350  # ms: of a frame of the film, and until the page has answered a click
_COLOURS = 256  # of the picture: so it stays small


@contextmanager
def opened(lf: lfgpu.LightField) -> Iterator[Any]:
    """Open the page of a light field and its map."""
    result = replace(lfgpu.estimate_depth(lf), timings={})  # they are of the machine that draws
    with lfgpu.Viewer(lf, result, port=0) as viewer, browser.chromium() as chromium:
        page = chromium.new_page(
            viewport={"width": SIZE[0], "height": SIZE[1]}, color_scheme="light", reduced_motion="reduce"
        )
        page.goto(viewer.url)
        page.wait_for_timeout(_WAIT)
        yield page


def seen(page: Any) -> Image.Image:
    """Take a picture of the page."""
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def film(page: Any) -> list[Image.Image]:
    """Move the camera between the views, walk through the view, focus on points, and turn the points in space."""
    frames = []
    page.mouse.move(SIZE[0] * 0.4, SIZE[1] * 0.4)
    page.mouse.down()
    for turn in np.linspace(0, 2 * np.pi, POINTS):
        page.mouse.move(SIZE[0] * (0.4 + 0.09 * np.sin(turn)), SIZE[1] * (0.4 + 0.1 * np.sin(2 * turn)))
        page.wait_for_timeout(_STEP)
        frames.append(seen(page))
    page.mouse.up()
    page.keyboard.press("r")
    for tab in ("View", "Refocus"):
        page.locator("#left-tabs").get_by_text(tab, exact=True).click()
        box = page.locator("#view").bounding_box()
        for turn in np.linspace(0, 2 * np.pi, POINTS, endpoint=False):
            x, y = 0.5 + 0.3 * np.cos(turn), 0.5 + 0.34 * np.sin(turn)
            page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])
            page.wait_for_timeout(_STEP)
            page.get_by_text("Computing").first.wait_for(state="hidden")
            frames.append(seen(page))
    page.locator("#right-tabs").get_by_text("3D", exact=True).click()
    page.wait_for_timeout(_WAIT)
    page.mouse.move(SIZE[0] * 0.8, SIZE[1] * 0.4)
    page.mouse.down()
    for turn in np.linspace(0, 2 * np.pi, TURNS):
        page.mouse.move(SIZE[0] * (0.8 + 0.014 * np.sin(turn)), SIZE[1] * (0.4 + 0.012 * np.cos(turn)))
        page.wait_for_timeout(2 * _STEP)
        frames.append(seen(page))
    page.mouse.up()
    return frames


def main(folder: str) -> None:
    """Write the picture and the film."""
    with opened(lfgpu.read(folder)) as page:
        page.mouse.move(SIZE[0] * 0.42, SIZE[1] * 0.28)
        page.wait_for_timeout(_WAIT // 2)
        drawn = seen(page)
        palette = drawn.quantize(_COLOURS, Image.Quantize.MEDIANCUT, kmeans=2)
        picture = drawn.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
        picture.save(DOCS / "viewer.png", optimize=True)
        first, *others = (frame.resize(SHOWN, Image.Resampling.LANCZOS) for frame in film(page))
    first.save(
        DOCS / "viewer.webp", save_all=True, append_images=others, duration=2 * _STEP, loop=0, quality=24, method=6
    )


if __name__ == "__main__":
    main(sys.argv[1])
