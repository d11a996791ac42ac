"""Pictures of the page in Chromium: their pixels are those of the data, and what people do changes them."""

import math
from typing import Any
from urllib.parse import parse_qs, urlsplit
from urllib.request import urlopen

import numpy as np
import pytest

from lfgpu.data import DisparityMap, LightField
from lfgpu.viewer import Viewer
from tests.browser import until
from tests.viewer.page import GREY, HOLE, MARK, SIZE, Page, marked, viridis


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
    rows = slice(math.floor(top + HOLE[0] * scale), math.ceil(top + HOLE[1] * scale))
    inside[rows, math.floor(left + HOLE[2] * scale) : math.ceil(left + HOLE[3] * scale)] = True
    assert not (grey & ~inside).any()


def test_pointing_says_the_values(page: Page, viewer: Viewer) -> None:
    contents = viewer.contents
    entry, truth = contents.entries["fast"], contents.truth
    page.tab.mouse.move(*page.spot("map", 33, 7))
    page.reads("x, y 33, 7")
    said = page.readout().replace("−", "-").replace("\n", " ")
    numbers = {name: float(said.split(f"{name} ")[1].split()[0]) for name in ("disparity", "confidence", "error")}
    assert numbers["disparity"] == pytest.approx(entry.disparity[7, 33], abs=1e-3)
    assert numbers["confidence"] == pytest.approx(entry.confidence[7, 33], abs=1e-3)
    assert numbers["error"] == pytest.approx(entry.disparity[7, 33] - truth[7, 33], abs=1e-3)
    page.tab.mouse.move(*page.spot("map", HOLE[2] + 2, HOLE[0] + 1))
    page.reads("disparity undefined")


def test_marks_follow_the_point_through_the_views(page: Page, viewer: Viewer, lf: LightField) -> None:
    """A click sets the pixel; in another view its lines are where the map says, and so they lead back to it."""
    disparity = viewer.contents.entries["fast"].disparity
    truth = lf.truth
    assert truth is not None
    x, y = 36, 10
    page.click("map", x, y)
    page.tab.mouse.move(5, 5)
    until(lambda: marked(page)() == [f"{x},", f"{y}"], "the pixel is chosen", page.tab)
    for key in ("ArrowRight", "ArrowRight", "ArrowUp"):
        page.tab.keyboard.press(key)
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
        at = [int(part.strip(",")) for part in marked(page)()]
        return bool(at) and abs(at[0] - x) <= 1 and abs(at[1] - y) <= 1

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
    page.enlarge("map", 30, 20, 3)
    page.moved("map", lambda place: place[2] > 20, "the map is enlarged")
    page.moved("view", lambda place: place[2] > 20, "the view is enlarged")
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
    page.drag(start, (start[0] + 60, start[1] + 30))
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
    x, y = box["x"] + left, box["y"] + top + 100
    page.drag((x + 0.36 * 48 * scale, y), (x + 2 * scale, y))
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
    limits = viewer.contents.limits("disparity")
    assert ends[0] <= limits[0] < limits[1] <= ends[1]
    colour = np.array(viridis(ends[0] + (np.argmax(shares) + 0.5) / bins * (ends[1] - ends[0]), limits))
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
    assert not [url for url in page.asked[before:] if "data/" in url and "data/histogram" not in url]  # its bins change
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


def test_a_map_alone_is_shown(browser: Any) -> None:
    disparity = np.linspace(-1, 1, SIZE[0] * SIZE[1], dtype=np.float32).reshape(SIZE)
    with Viewer(None, DisparityMap(disparity), port=0) as viewer, Page(browser, viewer) as page:
        page.shown("map", "disparity")
        assert not page.tab.locator("#view").is_visible()
        assert not page.tab.locator("#run").is_visible()
        page.tab.mouse.move(*page.spot("map", 10, 10))
        page.reads("disparity")
