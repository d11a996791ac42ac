"""The page of the viewer in a browser: its pixels are those of the data, and what people do changes them."""

from __future__ import annotations

import base64
import io
import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import parse_qs, urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from lfgpu import scenes
from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DisparityMap
from lfgpu.errors import LightFieldError
from lfgpu.io import load, read_map, write_hci, write_result
from lfgpu.io.live_maps import fingerprint, write_live_map
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.pipelines.sources.recording import recorded
from tests.browser import chromium, until

pytest.importorskip("viser", reason="viser is not installed: pip install -e '.[viewer]'")
pytest.importorskip("tornado", reason="tornado is not installed: pip install -e '.[viewer]'")

from lfgpu.viewer import Viewer

SIZE = (40, 48)
GREY = (158, 158, 158)
MARK = (232, 35, 122)  # on light pages
HOLE = (5, 8, 12, 20)  # top, bottom, left, right of the pixels that are unknown


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with chromium() as opened:
        yield opened


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=SIZE)


@pytest.fixture(scope="module")
def files(lf: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A light field and a result of it with a hole."""
    folder = tmp_path_factory.mktemp("shown")
    write_hci(lf, folder / "boxes")
    (folder / "fast").mkdir()
    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    disparity = result.disparity.copy()
    disparity[HOLE[0] : HOLE[1], HOLE[2] : HOLE[3]] = np.nan
    write_result(replace(result, disparity=disparity), folder / "fast" / "result.npz")
    return folder


@pytest.fixture(scope="module")
def viewer(files: Path) -> Iterator[Viewer]:
    with Viewer.of([files / "fast", files / "boxes"], port=0, allow_open=True) as opened:
        yield opened


class Page:
    """One tab that shows the viewer."""

    def __init__(self, browser: Any, viewer: Viewer, *, width: int = 1366, height: int = 650, **options: Any) -> None:
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        self.tab = context.new_page()
        self.errors: list[str] = []
        self.asked: list[str] = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("request", lambda request: self.asked.append(request.url))
        self.tab.goto(viewer.url)
        self.tab.set_default_timeout(60_000)

    def close(self) -> None:
        assert not self.errors
        self.tab.context.close()

    def key(self, name: str) -> str:
        """What a canvas shows when all of it has come: its sources and how they are coloured; else nothing."""
        return str(self.tab.evaluate("id => document.getElementById(id).dataset.drawn ?? ''", name))

    def pixels(self, name: str) -> np.ndarray:
        """A canvas, [y, x, 3]."""
        data = self.tab.evaluate("id => document.getElementById(id).toDataURL()", name)
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
        return str(self.tab.inner_text("#readout"))

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
        until(lambda: "chosen x, y 24, 2" in self.readout().replace("\n", " "), "the pixel is chosen", self.tab)


@pytest.fixture(scope="module")
def shared(browser: Any, viewer: Viewer) -> Iterator[Page]:
    opened = Page(browser, viewer)
    opened.shown("map", "disparity")
    opened.shown("view", "view")
    yield opened
    opened.close()


@pytest.fixture
def page(shared: Page) -> Page:
    """The tab that the tests share, for a page takes long to come; it is set back before each."""
    shared.back()
    return shared


def viridis(value: float, limits: tuple[float, float]) -> tuple[int, ...]:
    share = min(max((value - limits[0]) / (limits[1] - limits[0]), 0), 1)
    return tuple((colormaps["viridis"](int(255 * share + 0.5))[:3] * np.array(255) + 0.5).astype(int))


# --- pictures ---


def test_pixels_are_those_of_the_data(page: Page, viewer: Viewer, lf: LightField) -> None:
    contents = viewer.contents
    limits, disparity = contents.limits("disparity"), contents.entries["fast"].disparity
    page.shown("view", f" {lf.reference_index} ")
    for x, y in ((3, 30), (40, 4), (30, 33)):
        assert page.at("view", x, y) == tuple(lf.views[lf.reference_index, y, x])
        np.testing.assert_allclose(page.at("map", x, y), viridis(disparity[y, x], limits), atol=1)
    assert page.at("map", HOLE[2] + 2, HOLE[0] + 1) == GREY
    picture = page.pixels("map")
    left, top, scale = page.place("map")
    grey = (picture == GREY).all(axis=2)
    inside = np.zeros_like(grey)
    rows = slice(round(top + HOLE[0] * scale), round(top + HOLE[1] * scale))
    inside[rows, round(left + HOLE[2] * scale) : round(left + HOLE[3] * scale)] = True
    assert not (grey & ~inside).any()


def test_pointing_says_the_values(page: Page, viewer: Viewer, lf: LightField) -> None:
    contents = viewer.contents
    entry, truth = contents.entries["fast"], contents.truth
    assert entry.confidence is not None
    assert truth is not None
    page.tab.mouse.move(*page.spot("map", 33, 7))
    until(lambda: "x, y 33, 7" in page.readout().replace("\n", " "), "the pixel is said", page.tab)
    said = page.readout().replace("−", "-").replace("\n", " ")
    numbers = {name: float(said.split(f"{name} ")[1].split()[0]) for name in ("disparity", "confidence", "error")}
    assert numbers["disparity"] == pytest.approx(entry.disparity[7, 33], abs=1e-3)
    assert numbers["confidence"] == pytest.approx(entry.confidence[7, 33], abs=1e-3)
    assert numbers["error"] == pytest.approx(entry.disparity[7, 33] - truth[7, 33], abs=1e-3)
    page.tab.mouse.move(*page.spot("map", HOLE[2] + 2, HOLE[0] + 1))
    until(lambda: "disparity undefined" in page.readout().replace("\n", " "), "it is undefined there", page.tab)


def marked(page: Page) -> Callable[[], list[str]]:
    return lambda: page.readout().replace("\n", " ").split("disparity")[0].split()[-2:]


def test_marks_follow_the_point_through_the_views(page: Page, viewer: Viewer, lf: LightField) -> None:
    """A click sets the pixel; in another view its lines are where the map says, and so they lead back to it."""
    disparity = viewer.contents.entries["fast"].disparity
    truth = lf.truth
    assert truth is not None
    x, y = 36, 10
    page.click("map", x, y)
    page.tab.mouse.move(5, 5)
    until(lambda: marked(page)() == [f"{x},", f"{y}"], "the pixel is chosen", page.tab)
    page.tab.keyboard.press("ArrowRight")
    page.tab.keyboard.press("ArrowRight")
    page.tab.keyboard.press("ArrowUp")
    index = lf.index_of(1, 4)
    picture = page.shown("view", f" {index} ")
    assert "Row 1, column 4" in page.tab.inner_text("#left-title")
    left, top, scale = page.place("view")
    d = float(disparity[y, x])
    at = left + (x - 2 * d + 0.5) * scale, top + (y + d + 0.5) * scale
    pink = np.argwhere((picture == MARK).all(axis=2))
    assert np.allclose(pink.mean(axis=0), (at[1], at[0]), atol=1.5)
    page.tab.keyboard.press("Shift+ArrowLeft")  # away from there
    until(lambda: marked(page)() == [f"{x - 1},", f"{y}"], "the next pixel is chosen", page.tab)
    page.tab.mouse.click(*page.spot("view", x - 2 * d, y + d))  # what was marked leads back to the pixel
    page.tab.mouse.move(5, 5)

    def is_back() -> bool:
        a, b = (int(part.strip(",")) for part in marked(page)())
        return abs(a - x) <= 1 and abs(b - y) <= 1

    until(is_back, "the pixel is chosen again", page.tab)


def test_epis_are_in_line_with_the_view_and_lead_to_pixels(page: Page, lf: LightField) -> None:
    page.click("view", 20, 30)
    until(lambda: page.key("epi-row").endswith(" 30"), "the EPI of the row has come", page.tab)
    until(lambda: page.key("epi-column").endswith(" 20"), "the EPI of the column has come", page.tab)
    page.still()
    left, top, scale = page.place("view")
    for name, lines in (("epi-row", lf.epi_horizontal(30)), ("epi-column", lf.epi_vertical(20))):
        picture = page.pixels(name)
        picture = picture if name == "epi-row" else picture.transpose(1, 0, 2)
        thick, begin = picture.shape[0] // len(lines), left if name == "epi-row" else top
        start = (picture.shape[0] - thick * len(lines)) // 2
        for k in (0, len(lines) - 1):
            for at in (3, lines.shape[1] - 4):
                shown = picture[start + k * thick + thick // 2, int(begin + (at + 0.5) * scale)]
                np.testing.assert_array_equal(shown, lines[k, at])
    box = page.tab.locator("#epi-row").bounding_box()
    row = lf.row().tolist().index(lf.reference_index)
    page.tab.mouse.click(box["x"] + left + 41.5 * scale, box["y"] + (row + 0.5) * box["height"] / len(lf.row()))
    page.tab.mouse.move(5, 5)
    until(lambda: marked(page)() == ["41,", "30"], "the pixel of the EPI is chosen", page.tab)


def test_views_and_maps_are_enlarged_together_by_whole_numbers(page: Page, viewer: Viewer) -> None:
    entry = viewer.contents.entries["fast"]
    page.tab.mouse.move(*page.spot("map", 30, 20))
    for _ in range(4):
        page.tab.mouse.wheel(0, -200)
    page.moved("map", lambda place: place[2] > 45, "the map is enlarged")
    page.moved("view", lambda place: place[2] > 40, "the view is enlarged")
    places = [page.place(name) for name in ("map", "view")]
    sizes = [page.pixels(name).shape for name in ("map", "view")]
    for (left, top, scale), shape in zip(places, sizes, strict=True):
        assert scale == int(scale) > 15
        assert left <= 0 >= top
        middle = (shape[1] / 2 - left) / scale, (shape[0] / 2 - top) / scale
        assert middle == pytest.approx(
            ((sizes[0][1] / 2 - places[0][0]) / places[0][2], (sizes[0][0] / 2 - places[0][1]) / places[0][2]), abs=1.0
        )
    left, top, scale = (int(part) for part in places[0])
    picture = page.pixels("map")
    block = picture[top + 21 * scale : top + 22 * scale, left + 31 * scale : left + 32 * scale]
    assert (block == block[0, 0]).all()  # a pixel is a square of one colour
    limits = viewer.contents.limits("disparity")
    np.testing.assert_allclose(block[0, 0], viridis(entry.disparity[21, 31], limits), atol=1)
    start = page.spot("map", 31, 21)
    page.tab.mouse.move(*start)
    page.tab.mouse.down()
    page.tab.mouse.move(start[0] + 60, start[1] + 30, steps=3)
    page.tab.mouse.up()
    page.moved("map", lambda place: place[:2] == (left + 60, top + 30), "the map is moved")
    page.tab.mouse.dblclick(*page.spot("map", 30, 20))
    page.moved("map", lambda place: place[2] < scale, "everything is shown")


def test_maps_are_compared(page: Page, viewer: Viewer) -> None:
    contents = viewer.contents
    limits, truth, mine = contents.limits("disparity"), contents.truth, contents.entries["fast"].disparity
    assert truth is not None
    page.choose("other", "ground truth")
    page.tab.click("[data-value=wipe]")
    page.shown("map", " / ")

    def shows(x: int, y: int, values: np.ndarray, name: str = "map") -> None:
        np.testing.assert_allclose(page.at(name, x, y), viridis(values[y, x], limits), atol=1)

    shows(4, 30, mine)
    shows(44, 30, truth)
    assert "ground truth" in page.tab.inner_text("#wipe-label")
    left, top, scale = page.place("map")
    box = page.tab.locator("#map").bounding_box()
    page.tab.mouse.move(box["x"] + left + 24 * scale, box["y"] + top + 100)
    page.tab.mouse.down()
    page.tab.mouse.move(box["x"] + left + 2 * scale, box["y"] + top + 100, steps=3)
    page.tab.mouse.up()
    until(lambda: page.at("map", HOLE[2] + 2, HOLE[0] + 1) != GREY, "the wipe is drawn", page.tab)
    shows(4, 30, truth)
    page.tab.keyboard.press("t")
    until(lambda: page.tab.inner_text("#map-label") == "ground truth", "the other map is shown", page.tab)
    page.shown("map", "disparity")
    assert page.at("map", HOLE[2] + 2, HOLE[0] + 1) != GREY
    page.tab.keyboard.press("t")
    until(lambda: page.tab.inner_text("#map-label") == "fast", "the first map is shown", page.tab)
    page.shown("map", "disparity")
    assert page.at("map", HOLE[2] + 2, HOLE[0] + 1) == GREY
    page.tab.click("[data-value=side]")
    page.shown("other-map", "disparity")
    page.shown("map", "disparity")
    shows(4, 30, mine)
    shows(4, 30, truth, "other-map")
    page.choose("quantity", "error")
    page.shown("map", "error")
    assert "MSE×100" in page.tab.inner_text("#scores")


def test_the_distribution_is_that_of_the_map(page: Page, viewer: Viewer) -> None:
    disparity = viewer.contents.entries["fast"].disparity
    until(lambda: "disparity" in page.key("histogram"), "the distribution is drawn", page.tab)
    asked = next(url for url in reversed(page.asked) if "data/histogram" in url and "kind=disparity" in url)
    query = {name: found[0] for name, found in parse_qs(urlsplit(asked).query).items()}
    bins, ends = int(query["bins"]), (float(query["low"]), float(query["high"]))
    with urlopen(asked, timeout=10) as answer:
        shares = np.frombuffer(answer.read(), np.float32)
    known = disparity[np.isfinite(disparity)]
    np.testing.assert_allclose(shares, 100 * np.histogram(known, bins, ends)[0] / known.size, atol=1e-4)
    picture = page.pixels("histogram")
    colour = np.array(viridis(ends[0] + (np.argmax(shares) + 0.5) / bins * (ends[1] - ends[0]), ends))
    assert (np.abs(picture.astype(int) - colour).max(axis=2) <= 2).any()  # the highest bar, in its colour
    page.choose("quantity", "confidence")
    until(lambda: "confidence" in page.key("histogram"), "that of the confidence is drawn", page.tab)


def test_colours_change_without_the_server(page: Page, viewer: Viewer, lf: LightField) -> None:
    disparity = viewer.contents.entries["fast"].disparity
    page.tab.mouse.move(5, 5)
    page.tab.wait_for_timeout(200)
    before = len(page.asked)
    page.choose("colours", "gray")
    assert all(len(page.tab.input_value(end).lstrip("-")) <= 5 for end in ("#low", "#high"))  # a narrow field shows it
    page.tab.fill("#low", "-1")
    page.tab.fill("#high", "1")
    page.tab.press("#high", "Enter")
    page.shown("map", "gray -1 1")
    value = int(255 * (float(np.clip(disparity[30, 4], -1, 1)) + 1) / 2 + 0.5)
    assert page.at("map", 4, 30) == pytest.approx((value,) * 3, abs=1)
    assert page.tab.get_attribute("#colour-bar", "data-beyond") == (
        f"{str(np.nanmin(disparity) < -1).lower()} {str(np.nanmax(disparity) > 1).lower()}"
    )
    page.tab.evaluate("document.querySelectorAll('aside details').forEach(one => one.open = true)")
    page.set("exposure", 1)
    page.set("gamma", 2)
    page.shown("view", "1 2")
    stored = lf.views[lf.reference_index, 30, 4] / 255
    assert page.at("view", 4, 30) == pytest.approx(tuple(255 * np.minimum(1, 2 * stored) ** 0.5), abs=1)
    assert not [url for url in page.asked[before:] if "data/histogram" not in url]  # its bins are those of the range
    page.tab.click("#as-stored")
    page.tab.click("#auto")
    page.choose("colours", "viridis")
    page.shown("map", "viridis")


def test_a_click_puts_the_focus_there(page: Page, viewer: Viewer, lf: LightField) -> None:
    disparity = viewer.contents.entries["fast"].disparity
    page.tab.keyboard.press("o")
    page.click("view", 36, 10)
    focus = pytest.approx(float(disparity[10, 36]), abs=0.02)
    until(lambda: float(page.tab.input_value("#focus")) == focus, "the focus is there", page.tab)
    blurred = page.shown("view", "refocused")
    page.set("aperture", 0)
    page.shown("view", " 0 0 1")
    assert page.at("view", 4, 30) == pytest.approx(tuple(map(int, lf.views[lf.reference_index, 30, 4])), abs=1)
    assert (page.pixels("view") != blurred).any()
    page.tab.keyboard.press("a")
    sharp = page.shown("view", "sharp")
    assert len(np.unique(sharp.reshape(-1, 3), axis=0)) > 500


# --- estimates and files ---


def test_it_is_estimated_again(page: Page, viewer: Viewer) -> None:
    page.tab.evaluate("document.getElementById('parameters').open = true")
    page.choose("preset", "paper")
    assert page.tab.locator('[data-name="semi_global.small_penalty"]').count() == 0
    page.choose("preset", "fast")
    assert page.tab.locator('[data-name="refinement.iterations"]').count() == 0
    field = page.tab.locator('[data-name="alignment.iterations"] input')
    field.fill("many")
    page.tab.click("#run")
    page.says("must be a number, not 'many'")
    field.fill("3")
    page.tab.uncheck("#find-range")
    page.tab.fill("#from", "-2")
    page.tab.fill("#to", "2")
    page.tab.fill("#estimate-name", "three steps")
    page.tab.click("#run")
    page.says("three steps: done in", "#progress-text")
    page.tab.click("[data-value=wipe]")
    page.shown("map", " / ")
    assert page.tab.input_value("#result") == "three steps"
    assert page.tab.input_value("#other") == "fast"
    result = viewer.contents.entries["three steps"].result
    assert result is not None
    assert result.config.alignment.iterations == 3  # type: ignore[attr-defined]


def test_results_and_pictures_are_saved(page: Page, viewer: Viewer, tmp_path: Path) -> None:
    entry = viewer.contents.entries["fast"]
    page.tab.keyboard.press("s")
    page.tab.fill("#save-name", "my map")
    saved = {}
    buttons = {text: page.tab.get_by_role("button", name=text, exact=True) for text in (".npz", ".pfm", ".ply")}
    buttons["Map"] = page.tab.locator("#save-map")
    buttons["Map with scale"] = page.tab.locator("#save-figure")
    for text, button in buttons.items():
        with page.tab.expect_download() as download:
            button.click()
        saved[text] = tmp_path / download.value.suggested_filename
        download.value.save_as(saved[text])
    assert {path.name for path in saved.values()} == {
        "my map.npz", "my map.pfm", "my map.ply", "my map-disparity.png"
    }  # fmt: skip
    result = load(saved[".npz"])
    assert result.config == entry.result.config  # type: ignore[union-attr]
    np.testing.assert_array_equal(read_map(saved[".pfm"]), entry.disparity)
    np.testing.assert_allclose(read_map(saved[".ply"]), entry.disparity, atol=1e-5)


def test_saved_maps_have_one_pixel_for_each_and_no_marks(page: Page, viewer: Viewer, tmp_path: Path) -> None:
    entry = viewer.contents.entries["fast"]
    page.tab.keyboard.press("s")
    with page.tab.expect_download() as download:
        page.tab.click("#save-map")
    download.value.save_as(tmp_path / "map.png")
    with Image.open(tmp_path / "map.png") as image:
        found = np.asarray(image.convert("RGB"))
    limits = viewer.contents.limits("disparity")
    share = np.clip((np.nan_to_num(entry.disparity) - limits[0]) / (limits[1] - limits[0]), 0, 1)
    expected = (colormaps["viridis"]((255 * share + 0.5).astype(int))[..., :3] * 255 + 0.5).astype(np.uint8)
    expected[~np.isfinite(entry.disparity)] = GREY
    np.testing.assert_allclose(found.astype(int), expected.astype(int), atol=6)
    assert (np.abs(found.astype(int) - expected) <= 1).mean() > 0.99  # the next step of the colour map here and there


def test_help_and_what_cannot_be_opened(page: Page) -> None:
    page.tab.keyboard.press("?")
    assert page.tab.locator("#help").is_visible()
    assert "wheel" in page.tab.inner_text("#help").lower()
    page.tab.keyboard.press("Escape")
    page.tab.click("#open-files")
    page.tab.fill("#path", "/no/such/place")
    page.tab.press("#path", "Enter")
    page.says("/no/such/place does not exist")


def test_points_are_drawn_and_saved_without_marks(page: Page, tmp_path: Path) -> None:
    page.tab.keyboard.press("d")
    page.choose("space-paint", "confidence")

    until(lambda: not page.tab.locator("#space-note").is_visible(), "the points are on the page", page.tab)
    wide = int(page.tab.locator("#space-frame").bounding_box()["width"])
    page.tab.keyboard.press("s")

    def saved() -> list[np.ndarray]:
        with page.tab.expect_download() as download:
            page.tab.click("#save-space")
        download.value.save_as(tmp_path / "space.png")
        with Image.open(tmp_path / "space.png") as image:
            found = np.asarray(image.convert("RGB")).astype(int)
        return [found] if len(np.unique(found[:, :wide].reshape(-1, 3), axis=0)) > 100 else []

    found = until(saved, "points are in the picture", page.tab)[0]
    assert (found[:3, :3] == 255).all()  # the background of a light page
    for column in (found[:, wide:], page.pixels("space-bar")):  # beside the points stands their scale
        shades = colormaps["cividis"]([0.25, 0.5, 0.75], bytes=True)[:, :3].astype(int)
        assert all((np.abs(column - shade).max(axis=-1) <= 2).sum() > 10 for shade in shades)
    page.says("colour: confidence", "#right-title")
    pink = (found[..., 0] > 200) & (found[..., 1] < 120) & (found[..., 2] > 90)
    assert not pink.any()  # there is none in the colours of the confidence
    page.tab.keyboard.press("Escape")
    with Image.open(io.BytesIO(page.tab.locator("#space-frame").screenshot(timeout=90_000))) as image:
        seen = np.asarray(image.convert("RGB")).astype(int)
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 100
    assert ((seen[..., 0] > 200) & (seen[..., 1] < 120) & (seen[..., 2] > 90)).any()  # the mark


# --- several tabs, streams, the end ---


def test_each_tab_has_its_own_settings_and_follows_the_system(browser: Any, page: Page, viewer: Viewer) -> None:
    dark = Page(browser, viewer, color_scheme="dark")
    there = dark.shown("view", "view")
    page.tab.keyboard.press("ArrowUp")
    page.shown("view", " 7 ")
    np.testing.assert_array_equal(dark.pixels("view"), there)
    colours = [
        one.tab.evaluate("getComputedStyle(document.body).backgroundColor") for one in (page, dark)
    ]  # fmt: skip
    assert [int(colour.split("(")[1].split(",")[0]) > 128 for colour in colours] == [True, False]
    dark.close()


def test_a_phone_shows_one_part_at_a_time(browser: Any, viewer: Viewer) -> None:
    phone = Page(browser, viewer, width=390, height=844, has_touch=True, is_mobile=True)
    phone.shown("view", "view")
    for part, shown in (("view", "#view"), ("map", "#map"), ("settings", "#quantity")):
        phone.tab.tap(f"nav [data-value={part}]")
        assert phone.tab.locator(shown).is_visible()
        assert phone.tab.evaluate("document.documentElement.scrollWidth") <= 390
        box = phone.tab.locator(shown).bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390
    phone.tab.tap("nav [data-value=map]")
    phone.shown("map", "disparity")
    before = phone.place("map")
    x, y = (round(part) for part in phone.spot("map", 24, 20))
    touch = phone.tab.context.new_cdp_session(phone.tab)

    def fingers(kind: str, *places: tuple[int, int]) -> None:
        points = [{"x": px, "y": py, "id": k} for k, (px, py) in enumerate(places)]
        touch.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

    fingers("Start", (x - 20, y), (x + 20, y))
    for reach in (30, 45, 60, 80):
        fingers("Move", (x - reach, y), (x + reach, y))
    fingers("End")
    phone.moved("map", lambda place: place[2] > 2.5 * before[2], "two fingers enlarge")
    after = phone.place("map")
    assert [round(part) for part in phone.spot("map", 24, 20)] == pytest.approx([x, y], abs=after[2])
    phone.close()


def test_a_map_of_another_folder_joins_and_the_page_stays_as_it_is(browser: Any, files: Path) -> None:
    """Of its own viewer: how large the map is depends on how many maps the table has below it."""
    names = ("left", "right", "view", "map")
    with Viewer.of([files / "boxes", files / "fast"], port=0) as viewer:
        page = Page(browser, viewer)

        def boxes() -> list[Any]:
            return [page.tab.locator(f"#{name}").bounding_box() for name in names]

        page.shown("map", "disparity")
        until(lambda: page.tab.locator("#scores").is_visible(), "the table is there", page.tab)
        page.still()
        before = boxes()
        page.tab.click("#open-files")
        page.tab.fill("#path", str(files / "boxes"))
        page.tab.press("#path", "Enter")
        until(lambda: page.tab.input_value("#result") == "ground truth", "the light field is alone", page.tab)
        page.shown("map", "disparity")
        title = page.tab.inner_text("#right-title")
        assert "ground truth" in title
        assert "no estimate yet" in title
        assert page.tab.inner_text("#map-label") == "ground truth"
        until(lambda: boxes()[:2] == before[:2], "the parts are as wide as before", page.tab)
        viewer.open(files / "fast")
        page.shown("map", "disparity")
        until(lambda: page.tab.input_value("#result") == "fast", "the map is chosen", page.tab)
        until(lambda: boxes() == before, f"everything is as large as before, {before}", page.tab)
        page.close()


def test_a_stream_is_followed_without_scores_of_another_frame(
    browser: Any, lf: LightField, files: Path, rng: np.random.Generator
) -> None:
    switched: list[bool] = []
    assert lf.truth is not None
    with Viewer.of([files / "boxes"], port=0) as viewer:
        page = Page(browser, viewer)
        page.shown("map", "disparity")
        viewer.offer(pause=switched.append)
        viewer.update(
            lf.truth.disparity - 0.2,
            np.full(lf.size, 0.5),
            views=lf.views[::-1].copy(),
            rate=12.5,
            latency=0.04,
            dropped=3,
        )
        until(lambda: page.tab.input_value("#result") == "live", "the stream is shown", page.tab)
        live = page.key("map")
        page.says("12.5 frames/s · 40 ms latency · 3 dropped", "#stream")
        assert not page.tab.locator("#scores").is_visible()
        assert "error" not in page.readout()
        page.shown("view", "view")
        assert page.at("view", 4, 30) == tuple(lf.views[::-1][lf.reference_index, 30, 4])
        viewer.update(np.zeros(lf.size))
        page.shown("map", "disparity", before=live)
        stop = threading.Event()

        def push() -> None:
            while not stop.wait(0.01):
                viewer.update(lf.truth.disparity, views=lf.views)  # type: ignore[union-attr]

        pusher = threading.Thread(target=push)
        pusher.start()
        try:  # frames that come faster than pictures are left out, but pictures come
            for _ in range(3):
                live = page.key("map")
                page.shown("map", "disparity", before=live)
        finally:
            stop.set()
            pusher.join()
        page.tab.click("#pause")
        until(lambda: switched == [True], "the stream is paused", page.tab)
        page.says("paused", "#stream")
        viewer.close()
        until(lambda: page.tab.locator("#gone").is_visible(), "the page says that the viewer has gone", page.tab)
        page.close()


def test_all_tiles_are_of_one_frame(browser: Any) -> None:
    """Frames of one colour each, which come faster than tiles: no picture that is drawn has two colours."""
    views = np.zeros((2, 1100, 1500, 1), np.uint8)
    with Viewer(LightField(views, [[0, 0], [1, 0]], name="film"), port=0) as viewer:
        page = Page(browser, viewer)
        page.shown("view", "view")
        page.tab.mouse.move(*page.spot("view", 700, 550))
        for _ in range(3):
            page.tab.mouse.wheel(0, -200)
        page.moved("view", lambda place: place[2] >= 1, "the view is enlarged")
        stop = threading.Event()

        def push() -> None:
            shade = 0
            while not stop.wait(0.02):
                shade = shade % 250 + 5
                viewer.update(np.full((1100, 1500), shade, np.float32), views=np.full_like(views, shade))

        pusher = threading.Thread(target=push)
        pusher.start()
        code = """() => {
            const canvas = document.getElementById("view"), map = document.getElementById("map");
            if (!canvas.dataset.drawn) return null;
            const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height), found = {};
            for (let k = 0; k < data.length; k += 4) {
                const key = `${data[k]},${data[k + 1]},${data[k + 2]}`;
                if (data[k + 3] === 255) found[key] = (found[key] ?? 0) + 1;
            }
            return [canvas.dataset.drawn, found, canvas.width * canvas.height];
        }"""
        try:
            seen: set[str] = set()
            while len(seen) < 6:
                answer = page.tab.evaluate(code)
                if answer is None or answer[0] in seen:
                    page.tab.wait_for_timeout(10)
                    continue
                key, found, count = answer
                seen.add(key)
                large = [colour for colour, times in found.items() if times > 0.04 * count]
                assert len(large) == 1, (key, found)  # the marks are small
        finally:
            stop.set()
            pusher.join()
        page.close()


def test_a_film_is_looked_at_frame_by_frame(browser: Any, lf: LightField, tmp_path: Path) -> None:
    frames = [replace(lf, views=np.full_like(lf.views, shade), truth=None) for shade in (40, 90, 160)]
    for _ in recorded(iter(frames), lf, tmp_path / "film"):
        pass
    log = [{"frame": n, "reference": fingerprint(frame.views[lf.reference_index])} for n, frame in enumerate(frames)]
    log[1]["error"] = "this frame was dropped"
    for number in (0, 2):
        write_live_map(tmp_path / "maps", number, np.full(SIZE, number + 1, np.float32), np.ones(SIZE, np.float32))
    (tmp_path / "maps" / "live.json").write_text(json.dumps({"frames": log}))
    with Viewer.of([tmp_path / "maps", tmp_path / "film"], port=0) as viewer:
        page = Page(browser, viewer)
        page.shown("map", "disparity")

        def shows(number: int) -> None:
            page.says(f"Frame {number + 1} of 3", "#film-text")
            shade = (40, 90, 160)[number]
            until(lambda: page.at("view", 3, 3) == (shade, shade, shade), f"frame {number} is shown", page.tab)

        shows(0)
        page.tab.keyboard.press(".")
        shows(1)
        until(lambda: page.tab.locator("#map-note").is_visible(), "there is no map of this frame", page.tab)
        page.tab.click("#following")
        shows(2)
        until(lambda: "disparity 3.000" in page.readout().replace("\n", " "), "the map is of this frame", page.tab)
        page.tab.keyboard.press(",")
        page.tab.keyboard.press(",")
        shows(0)
        until(lambda: "disparity 1.000" in page.readout().replace("\n", " "), "the map is of this frame", page.tab)
        page.tab.click("#play")
        shows(2)
        page.tab.click("#play")
        page.close()
        with pytest.raises(LightFieldError, match="has no frame 3"):
            viewer.turn(3)
        (tmp_path / "film" / "frame_000001" / "views.npz").unlink()
        with pytest.raises(LightFieldError, match="frame_000001"):
            viewer.turn(1)
    with pytest.raises(LightFieldError, match="give the folder of the recorded frames, too"):
        Viewer.of([tmp_path / "maps"], port=0)


def test_large_views_come_in_tiles_when_they_are_looked_at(browser: Any) -> None:
    views = np.random.default_rng(1).integers(0, 256, (2, 1200, 1600, 1), np.uint8)
    with Viewer(LightField(views, [[0, 0], [1, 0]], name="large"), port=0) as viewer:
        index = viewer.contents.lf.reference_index  # type: ignore[union-attr]
        page = Page(browser, viewer)
        page.shown("view", "view")
        tiles = [url for url in page.asked if "data/view" in url]
        assert tiles
        assert not any("level=0" in url for url in tiles)
        page.tab.mouse.move(*page.spot("view", 1300, 900))
        for _ in range(5):
            page.tab.mouse.wheel(0, -200)
        page.moved("view", lambda place: place[2] > 1, "the view is enlarged")
        page.shown("view", "view")
        fine = [url for url in page.asked if f"index={index}&" in url and "level=0" in url]
        assert 0 < len(fine) < 12  # the whole view has 12
        assert page.at("view", 1300, 900) == (views[index, 900, 1300, 0],) * 3
        page.close()


# --- who may ask ---


def status(viewer: Viewer, path: str, *, body: bytes | None = None, **headers: str) -> int:
    found = urlsplit(viewer.url)
    request = Request(f"http://{found.netloc}{found.path}{path}", body, headers)
    try:
        with urlopen(request, timeout=10) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code


def test_nothing_is_reached_from_elsewhere(viewer: Viewer) -> None:
    port = urlsplit(viewer.url).port
    assert port is not None
    others = {info[4][0] for info in socket.getaddrinfo(socket.gethostname(), port, socket.AF_INET)} - {"127.0.0.1"}
    for address in {*others, "127.0.0.2"}:
        with socket.socket() as probe:
            probe.settimeout(2)
            assert probe.connect_ex((address, port)) != 0, address
    with socket.create_connection(("127.0.0.1", port), 2):
        pass


@pytest.mark.parametrize(("origin", "answer"), [("http://evil.example", "403"), ("null", "403"), (None, "101")])
def test_pages_of_other_sites_are_refused(viewer: Viewer, origin: str | None, answer: str) -> None:
    found = urlsplit(viewer.url)
    own = f"http://{found.netloc}"
    lines = [
        f"GET {found.path}tab HTTP/1.1", f"Host: {found.netloc}", f"Origin: {origin or own}", "Upgrade: websocket",
        "Connection: Upgrade", "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13",
    ]  # fmt: skip
    with socket.create_connection(("127.0.0.1", found.port), 5) as connection:
        connection.sendall(("\r\n".join(lines) + "\r\n\r\n").encode())
        assert connection.recv(200).decode().split()[1] == answer
    post = {"body": b'{"path": ""}', "Content-Type": "application/json", "Origin": origin or own}
    assert status(viewer, "do/open", **post) == (403 if origin else 400)  # type: ignore[arg-type]


def test_forms_and_names_of_other_machines_are_refused(viewer: Viewer) -> None:
    assert status(viewer, "do/stop", body=b"{}", **{"Content-Type": "text/plain"}) == 415
    for body in (b"[]", b"[" * 100_000, b'{"name": ' + b"9" * 5000 + b"}"):
        assert status(viewer, "do/stop", body=body, **{"Content-Type": "application/json"}) == 400
    assert status(viewer, "", Host="evil.example") == 403
    assert status(viewer, "") == 200


@pytest.mark.parametrize("path", ["/", "/index.html", "/x/", "/?token=x", "/x/index.html", "/x/data/fixed", "/x/tab"])
def test_nobody_without_the_token_is_answered(viewer: Viewer, path: str) -> None:
    with pytest.raises(HTTPError, match="403"):
        urlopen(f"http://{urlsplit(viewer.url).netloc}{path}", timeout=10)
    with urlopen(viewer.url, timeout=10) as answer:
        assert b"<html" in answer.read()
        assert "script-src 'self'" in answer.headers["Content-Security-Policy"]
        assert answer.headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    ("path", "answer"),
    [
        ("../web.py", 404), ("%2e%2e/web.py", 403), ("data/nothing", 404), ("style.css", 200),
        ("data/view?index=99&level=0&column=0&row=0", 400),
        ("data/view?index=0&level=99&column=0&row=0", 400), ("data/view?index=x&level=0&column=0&row=0", 400),
        ("data/view?index=nan&level=0&column=0&row=0", 400), ("data/map?result=none&kind=disparity", 400),
        ("file/figure?result=fast&kind=disparity&colours=viridis&low=-1e308&high=1e308", 400),
        ("data/epi?along=row&at=-1", 400), ("data/refocused?disparity=inf&aperture=1&level=0", 400),
        ("file/result?result=fast&suffix=.jpg", 400), ("file/space?tab=x", 400), ("space/x/", 404),
    ],
)  # fmt: skip
def test_nonsense_is_answered_with_a_sentence(
    viewer: Viewer, path: str, answer: int, capfd: pytest.CaptureFixture[str]
) -> None:
    assert status(viewer, path) in {answer, 403 if ".." in path else answer}
    assert capfd.readouterr().err == ""


_PAYLOAD = '<img src=x onerror="window.owned = 1"><script>window.owned = 2</script>'


def test_text_from_files_does_not_become_part_of_the_page(browser: Any, lf: LightField, tmp_path: Path) -> None:
    """A result with a script in its status, in a folder with a script in its name."""
    folder = tmp_path / _PAYLOAD.replace("/", ".")
    folder.mkdir()
    result = estimate_depth(lf, config="fast", disparity_range=(-2, 2))
    write_result(replace(result, status=_PAYLOAD, device=_PAYLOAD, backend=_PAYLOAD), folder / "result.npz")
    write_hci(lf, tmp_path / "boxes")
    with Viewer.of([tmp_path / "boxes", folder], port=0) as viewer:
        page = Page(browser, viewer)
        page.shown("map", "disparity")
        page.says(_PAYLOAD, "#about")
        page.tab.wait_for_timeout(300)  # for what would be run
        assert page.tab.evaluate("window.owned") is None
        assert page.tab.locator("img[src=x]").count() == 0
        page.close()


@pytest.mark.parametrize("wish", [{"range": [0, 10**400]}, {"range": [-1e300, 1]}, {"values": [1]}, {"preset": {}}])
def test_estimates_that_cannot_be_are_answered_with_a_sentence(viewer: Viewer, wish: dict[str, Any]) -> None:
    body = json.dumps({"preset": "fast", **wish}).encode()
    assert status(viewer, "do/estimate", body=body, **{"Content-Type": "application/json"}) == 400


def test_pages_open_only_what_was_given(files: Path, lf: LightField, tmp_path: Path) -> None:
    write_hci(lf, tmp_path / "other")
    (tmp_path / "link").symlink_to(files / "fast")
    with Viewer.of([files / "boxes"], port=0) as viewer:
        for path in (tmp_path / "other", files / "fast", files / "boxes" / ".." / "fast", tmp_path / "link", "/"):
            with pytest.raises(LightFieldError, match="--allow-open"):
                viewer.open_from_page(path)
            body = json.dumps({"path": str(path)}).encode()
            assert status(viewer, "do/open", body=body, **{"Content-Type": "application/json"}) == 400
        viewer.open_from_page(files / "boxes")
        viewer.open(files / "fast")  # its owner may


def test_nonsense_from_a_page_leaves_the_others_alone(
    page: Page, viewer: Viewer, caplog: pytest.LogCaptureFixture, rng: np.random.Generator
) -> None:
    from websockets.sync.client import connect

    address = viewer.url.replace("http://", "ws://") + "tab"
    scenes = [
        '{"x": 1e999}',
        '{"low": NaN}',
        '{"result": "fast", "exposure": 1e6}',
        '{"low": 1' + "0" * 400 + "}",
        '{"size": []}',
        '{"of": 1}',
        '{"__class__": {}}',
        "1",
    ]
    for data in (
        b"",
        b"\xff" * 100,
        rng.bytes(1000),
        "text",
        "[]",
        "[" * 100_000,
        *map('{{"scene": {}}}'.format, scenes),
    ):
        with connect(address, origin=viewer.url.rsplit("/", 2)[0]) as connection:
            connection.send(data)
            with suppress(Exception):
                connection.recv(timeout=0.3)
    assert not [record for record in caplog.records if record.exc_info]  # else a traceback is on the terminal
    page.tab.keyboard.press("ArrowUp")
    page.shown("view", " 7 ")


def test_a_map_alone_is_shown(browser: Any) -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    with Viewer(None, DisparityMap(disparity), port=0) as viewer:
        page = Page(browser, viewer)
        page.shown("map", "disparity")
        assert not page.tab.locator("#view").is_visible()
        assert not page.tab.locator("#run").is_visible()
        page.tab.mouse.move(*page.spot("map", 10, 10))
        until(lambda: "disparity" in page.readout(), "the value is said", page.tab)
        page.close()
