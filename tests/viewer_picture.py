"""The picture of the viewer in the README: the page in headless Chromium, on a scene of the package.

python tests/viewer_picture.py                   # writes docs/viewer.png
python tests/viewer_picture.py MY/LIGHT_FIELD    # of another light field
"""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path

import browser
from PIL import Image

import lfgpu
from lfgpu import scenes

PICTURE = Path(__file__).parents[1] / "docs" / "viewer.png"
SIZE = (1440, 700)
_WAIT = 6000  # ms: until the page has drawn all
_COLOURS = 256  # of the file: so it stays small


def draw(lf: lfgpu.LightField) -> Image.Image:
    """The page of the viewer with a light field and its map, as the mouse rests on a view."""
    result = replace(lfgpu.estimate_depth(lf), timings={})  # they are of the machine that draws
    with lfgpu.Viewer(lf, result, port=0) as viewer, browser.chromium() as chromium:
        page = chromium.new_page(viewport={"width": SIZE[0], "height": SIZE[1]}, color_scheme="light")
        page.goto(viewer.url)
        page.wait_for_timeout(_WAIT)
        page.mouse.move(SIZE[0] * 0.42, SIZE[1] * 0.28)
        page.wait_for_timeout(_WAIT // 2)
        return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def main(folder: str | None = None) -> None:
    """Write the picture."""
    lf = lfgpu.read(folder) if folder else scenes.make("boxes", grid=(9, 9), size=(384, 512))
    drawn = draw(lf)
    palette = drawn.quantize(_COLOURS, Image.Quantize.MEDIANCUT, kmeans=2)
    drawn.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main(*sys.argv[1:2])
