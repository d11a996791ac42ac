"""Tiles that the page asks for: those that are seen, as fine as the screen, and those that come next."""

from collections.abc import Iterator
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest

from lfgpu.data import DisparityMap, LightField
from lfgpu.viewer import Viewer
from lfgpu.viz.refocusing import all_in_focus
from lfgpu.viz.splines import LINEAR
from tests.browser import until
from tests.viewer.page import Page


def test_large_views_come_in_tiles_when_they_are_looked_at(browser: Any) -> None:
    views = np.random.default_rng(1).integers(0, 256, (2, 1200, 1600, 1), np.uint8)
    with Viewer(LightField(views, [[0, 0], [1, 0]], name="large"), port=0) as viewer:
        index = viewer.contents.lf.reference_index  # type: ignore[union-attr]
        page = Page(browser, viewer)
        page.shown("view", "view")
        tiles = [url for url in page.asked if "data/view" in url]
        assert tiles
        assert not any("level=0" in url for url in tiles)
        page.enlarge("view", 1300, 900, 5)
        page.moved("view", lambda place: place[2] > 1, "the view is enlarged")
        page.shown("view", "view")
        fine = [url for url in page.asked if f"index={index}&" in url and "level=0" in url]
        assert 0 < len(fine) < 12  # the whole view has 12
        assert page.at("view", 1300, 900) == (views[index, 900, 1300, 0],) * 3
        page.close()


def asked_for(page: Page, what: str) -> list[dict[str, str]]:
    """The words of all requests for a kind of picture, in order."""
    found = (urlsplit(url) for url in page.asked if f"data/{what}?" in url)
    return [{name: words[0] for name, words in parse_qs(one.query).items()} for one in found]


def test_neighbours_of_a_view_are_loaded_ahead(browser: Any) -> None:
    """An arrow key shows a view whose tiles have come: the server is asked only for those that may come next."""
    views = np.random.default_rng(1).integers(0, 256, (3, 5, 60, 80, 1), np.uint8)
    with Viewer(LightField.from_grid(views), port=0) as viewer, Page(browser, viewer) as page:
        page.shown("view", " 7 ")
        until(lambda: len(asked_for(page, "view")) == 5, "the neighbours are asked for", page.tab)
        first, *ahead = (int(one["index"]) for one in asked_for(page, "view"))
        assert first == 7  # what is looked at comes first
        assert set(ahead) == {2, 12, 6, 8}
        page.tab.wait_for_load_state("networkidle")
        page.tab.keyboard.press("ArrowRight")
        page.shown("view", " 8 ")
        assert page.at("view", 40, 30) == (views[1, 3, 30, 40, 0],) * 3
        until(lambda: len(asked_for(page, "view")) == 8, "those of the next view are asked for", page.tab)
        assert {int(one["index"]) for one in asked_for(page, "view")[5:]} == {3, 13, 9}


@pytest.fixture(scope="module")
def large() -> Iterator[Viewer]:
    views = np.random.default_rng(1).integers(0, 256, (1, 3, 900, 1200, 1), np.uint8)
    disparity = np.linspace(-1, 1, 900 * 1200, dtype=np.float32).reshape(900, 1200)
    with Viewer(LightField.from_grid(views), DisparityMap(disparity), port=0) as viewer:
        yield viewer


@pytest.mark.parametrize(("width", "fine"), [(1366, 1), (2200, 0)])
@pytest.mark.parametrize(("key", "what"), [("o", "refocused"), ("a", "sharp")])
def test_what_is_computed_comes_coarse_and_then_as_fine_as_the_screen(
    browser: Any, large: Viewer, width: int, fine: int, key: str, what: str
) -> None:
    """First one small picture; then tiles of which the screen enlarges no pixel by more than 1.25."""
    page = Page(browser, large, width=width, height=width)
    page.shown("view", "view")
    page.tab.keyboard.press(key)
    page.shown("view", what)
    scale = page.place("view")[2]
    assert scale * 2**fine <= 1.25 < scale * 2 ** (fine + 1)
    columns, rows = (-(-side // (256 << fine)) for side in (1200, 900))
    until(lambda: len(asked_for(page, what)) == 1 + rows * columns, "all tiles are asked for", page.tab)
    first, *later = asked_for(page, what)
    assert (first["level"], first["column"], first["row"]) == ("2", "0", "0")  # 300 x 225 pixels
    assert {one["level"] for one in later} == {str(fine)}
    assert {(int(one["column"]), int(one["row"])) for one in later} == set(np.ndindex(columns, rows))
    page.close()


def test_only_the_part_that_is_seen_is_computed(browser: Any, large: Viewer) -> None:
    page = Page(browser, large)
    page.shown("view", "view")
    page.enlarge("view", 1000, 100, 6)
    page.moved("view", lambda place: place[2] >= 5, "the view is enlarged")
    page.tab.keyboard.press("a")
    page.shown("view", "sharp")
    until(lambda: len(asked_for(page, "sharp")) > 1, "it is computed as fine as the screen", page.tab)
    page.tab.wait_for_load_state("networkidle")
    later = asked_for(page, "sharp")[1:]
    assert {one["level"] for one in later} == {"0"}
    assert len(later) <= 4  # of 20
    assert ("3", "0") in {(one["column"], one["row"]) for one in later}
    lf, entry = large.contents.lf, large.contents.entries["result"]
    whole = all_in_focus(lf, entry.map, order=LINEAR)
    x, y = 1000, 100
    until(lambda: abs(page.at("view", x, y)[0] - 255 * whole[y, x, 0]) <= 1, "the fine tile is drawn", page.tab)
    page.close()
