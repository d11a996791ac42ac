"""A tab of the browser that shows the viewer, as tests use it."""

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from PIL import Image

from lfgpu.viewer import Viewer
from tests.browser import until

SIZE = (40, 48)
GREY = (158, 158, 158)
MARK = (232, 35, 122)  # on light pages
HOLE = (5, 8, 12, 20)  # top, bottom, left, right of the pixels that are unknown


class Page:
    """One tab that shows the viewer."""

    def __init__(
        self, browser: Any, viewer: Viewer, *, width: int = 1366, height: int = 650, script: str = "", **options: Any
    ) -> None:
        """With `script`, JavaScript that runs before that of the page."""
        context = browser.new_context(
            viewport={"width": width, "height": height}, **{"reduced_motion": "reduce", **options}
        )
        context.add_init_script(script)
        self.tab = context.new_page()
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(viewer.url)
        self.tab.set_default_timeout(60_000)

    def __enter__(self) -> "Page":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.close()
        else:
            self.tab.context.close()

    def close(self) -> None:
        assert not self.errors
        self.tab.context.close()

    def key(self, name: str) -> str:
        """Return the sources and colours of a canvas of which all has come; else nothing."""
        return str(self.tab.evaluate("id => document.getElementById(id).dataset.drawn ?? ''", name))

    def pixels(self, name: str) -> np.ndarray:
        """A canvas, [y, x, 3]."""
        data = self.tab.evaluate(
            "id => (e => e.querySelector('canvas') ?? e)(document.getElementById(id)).toDataURL()", name
        )
        with Image.open(io.BytesIO(base64.b64decode(data.partition(",")[2]))) as image:
            return np.asarray(image.convert("RGB"))

    def place(self, name: str) -> tuple[float, float, float]:
        """(left, top, scale) of the picture on a canvas."""
        found = self.tab.evaluate("id => ({ ...document.getElementById(id).dataset })", name)
        return float(found["left"]), float(found["top"]), float(found["scale"])

    def shown(self, name: str, what: str, before: str | None = None) -> np.ndarray:
        """A canvas, when it shows all of something; with `before`, of something else than that."""

        def is_there() -> bool:
            key = self.key(name)
            return what in key and key != before

        until(is_there, f"{name} shows {what!r}; it shows {self.key(name)!r}", self.tab)
        self.still()  # for marks, which come with the next frame
        return self.pixels(name)

    def at(self, name: str, x: float, y: float) -> tuple[int, ...]:
        """The colour of a canvas in the middle of a pixel of the picture."""
        left, top, scale = self.place(name)
        picture = self.pixels(name)
        return tuple(map(int, picture[int(top + (y + 0.5) * scale), int(left + (x + 0.5) * scale)]))

    def spot(self, name: str, x: float, y: float) -> tuple[float, float]:
        """The place in the window of a pixel of the picture."""
        box = self.tab.locator(f"#{name}").bounding_box()
        left, top, scale = self.place(name)
        return box["x"] + left + (x + 0.5) * scale, box["y"] + top + (y + 0.5) * scale

    def click(self, name: str, x: float, y: float) -> None:
        self.tab.mouse.click(*self.spot(name, x, y))

    def enlarge(self, name: str, x: float, y: float, turns: int, by: int = 200) -> None:
        """Turn the wheel over a pixel of the picture."""
        self.tab.mouse.move(*self.spot(name, x, y))
        for _ in range(turns):
            self.tab.mouse.wheel(0, -by)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Press, move and release the button of the mouse, at places in the window."""
        self.tab.mouse.move(*start)
        self.tab.mouse.down()
        self.tab.mouse.move(*end, steps=4)
        self.tab.mouse.up()

    def saved(self, button: Any, folder: Path, wait: float = 60_000) -> Path:
        """Press what saves something, and return the file."""
        with self.tab.expect_download(timeout=wait) as download:
            self.tab.locator(button).click() if isinstance(button, str) else button.click()
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def space(self) -> np.ndarray:
        """The points as they are seen, [y, x, 3]."""
        with Image.open(io.BytesIO(self.tab.locator("#space-frame").screenshot(timeout=90_000))) as image:
            return np.asarray(image.convert("RGB")).astype(int)

    def has_points(self) -> None:
        until(lambda: not self.tab.locator("#space-note").is_visible(), "the points are on the page", self.tab)

    def choose(self, name: str, value: str) -> None:
        self.tab.select_option(f"#{name}", value)

    def set(self, name: str, value: float) -> None:
        """Move a slider."""
        code = "([id, value]) => { const e = document.getElementById(id); e.value = value; e.oninput(); }"
        self.tab.evaluate(code, [name, value])

    def still(self) -> None:
        """Wait until everything that was going to be drawn is: nothing changes from one frame to the next."""
        self.tab.evaluate("() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")

    def moved(self, name: str, condition: Callable[[tuple[float, float, float]], bool], what: str) -> None:
        """Wait until the place of a picture on its canvas is as wanted."""
        until(lambda: condition(self.place(name)), f"{what}; {name} is at {self.place(name)}", self.tab)

    def readout(self) -> str:
        """What is said of a pixel, in one line."""
        return str(self.tab.inner_text("#readout")).replace("\n", " ")

    def reads(self, text: str) -> None:
        until(lambda: text in self.readout(), f"the readout says {text!r}", self.tab)

    def says(self, text: str, where: str = "#messages") -> None:
        until(lambda: text in self.tab.inner_text(where), f"{where} says {text!r}", self.tab)

    def back(self) -> None:
        """As it was at first, whatever a test has chosen."""
        self.tab.evaluate("document.querySelectorAll('dialog[open]').forEach(one => one.close())")
        self.tab.evaluate("document.activeElement.blur()")
        for key in ("f", "r", "m"):
            self.tab.keyboard.press(key)
        for name, value in (("quantity", "disparity"), ("result", "fast"), ("other", "")):
            self.choose(name, value)
        self.shown("map", "disparity")
        self.click("map", 24, 2)  # so that the marks are not where tests look
        self.tab.mouse.move(5, 5)
        self.reads("chosen x, y 24, 2")


def viridis(value: float, limits: tuple[float, float]) -> tuple[int, ...]:
    share = min(max((value - limits[0]) / (limits[1] - limits[0]), 0), 1)
    return tuple((colormaps["viridis"](int(255 * share + 0.5))[:3] * np.array(255) + 0.5).astype(int))


def marked(page: Page) -> Callable[[], list[str]]:
    """What the page says of the pixel that was chosen; [] while it says something of the one under the pointer."""

    def found() -> list[str]:
        said = page.readout().split("disparity")[0].split()
        return said[-2:] if "chosen" in said else []

    return found
