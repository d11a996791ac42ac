"""The address of the page holds what is shown; and a page of its own shows the same without a server and a network."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.viewer import Viewer
from lfgpu.viewer.contents import Contents
from lfgpu.viewer.standalone import standalone
from tests.browser import until
from tests.viewer.page import HOLE, Page


class File:
    """What `Page` needs of a viewer: an address."""

    def __init__(self, path: Path) -> None:
        self.url = path.as_uri()


def test_a_file_shows_the_same_sight_without_a_server(
    browser: Any, page: Page, viewer: Viewer, lf: LightField, tmp_path: Path
) -> None:
    page.choose("other", "ground truth")
    page.tab.click("#compare [data-value=minus]")
    page.click("map", 33, 12)
    page.tab.mouse.move(5, 5)
    page.reads("33, 12")
    expected = page.shown("map", "minus").astype(int)
    readout = page.readout().split()
    page.tab.wait_for_timeout(700)
    page.tab.keyboard.press("s")
    page.tab.fill("#save-name", "supplement")
    assert page.saved("#save-page", tmp_path).name == "supplement.html"
    text = (tmp_path / "supplement.html").read_text()
    assert viewer.url not in text
    assert 'src="' not in text.split("<body")[0]
    alone = Page(browser, File(tmp_path / "supplement.html"), offline=True)
    found = alone.shown("map", "minus").astype(int)
    alone.reads("33, 12")
    assert alone.place("map")[2] == pytest.approx(page.place("map")[2], rel=0.1)
    for x, y in ((4, 30), (44, 8), (24, 36)):
        at = [one.at("map", x, y) for one in (page, alone)]
        assert at[0] == pytest.approx(at[1], abs=3)
    assert len(found) > 0 < len(expected)
    words = [word for word in readout if word.isalpha() and word != "colour"]  # that of compressed views is not stored
    assert [word for word in alone.readout().split() if word.isalpha()] == words
    assert alone.at("map", HOLE[2] + 2, HOLE[0] + 1) == (158, 158, 158)
    alone.tab.keyboard.press("ArrowRight")
    alone.shown("view", f" {lf.index_of(2, 3)} ")
    stored = lf.views[lf.index_of(2, 3), 30, 4].astype(int)
    np.testing.assert_allclose(alone.at("view", 4, 30), stored, atol=30)  # views are compressed
    until(lambda: alone.key("epi-row") != "", "the EPI is drawn", alone.tab)
    until(lambda: "minus" in alone.key("histogram"), "the distribution is drawn", alone.tab)
    assert not alone.tab.locator("#run").is_visible()
    assert all(url.startswith(("file:", "data:", "blob:")) for url in alone.asked)
    alone.close()


def test_pages_keep_their_data_apart_from_their_words(lf: LightField) -> None:
    named = standalone(Contents(LightField(lf.views, lf.positions, name="</script><b>")), "x").decode()
    assert "</script><b>" not in named
    data = json.loads(named.split('id="data">')[1].split("</script>")[0])
    assert data["state"]["lightField"]["name"] == "</script><b>"
    with pytest.raises(LightFieldError, match="nothing to show"):
        standalone(Contents(), "")


def test_pictures_are_saved_in_whole_numbers_of_their_size(page: Page, lf: LightField, tmp_path: Path) -> None:
    page.tab.keyboard.press("s")
    page.choose("save-times", "4")
    saved = page.saved("#save-view", tmp_path)
    page.choose("save-times", "1")
    with Image.open(saved) as image:
        found = np.asarray(image.convert("RGB"))
    np.testing.assert_array_equal(found, lf.views[lf.reference_index].repeat(4, axis=0).repeat(4, axis=1))


def test_a_link_opens_the_same_sight(browser: Any, page: Page, viewer: Viewer) -> None:
    page.choose("other", "ground truth")
    page.tab.click("#compare [data-value=minus]")
    page.click("map", 33, 12)
    page.tab.keyboard.press("ArrowRight")
    page.enlarge("map", 30, 20, 3)
    page.shown("map", "minus")
    page.tab.mouse.move(5, 5)
    page.reads("33, 12")
    page.tab.wait_for_timeout(900)
    address = page.tab.url
    assert "minus" in address
    again = Page(browser, viewer)
    again.tab.goto(address)
    again.tab.reload()
    again.shown("map", "minus")
    again.reads("33, 12")
    again.moved("map", lambda place: place == page.place("map"), "it is enlarged")
    assert (again.shown("map", "minus") == page.pixels("map")).all()
    assert again.tab.inner_text("#left-title") == page.tab.inner_text("#left-title")
    again.close()


def test_changes_are_taken_back(page: Page) -> None:
    page.tab.wait_for_timeout(600)
    page.choose("quantity", "confidence")
    page.shown("map", "confidence")
    page.tab.wait_for_timeout(600)
    page.tab.keyboard.press("ArrowRight")
    until(lambda: "reference" not in page.tab.inner_text("#left-title"), "the next view", page.tab)
    page.tab.wait_for_timeout(600)
    page.tab.keyboard.press("Control+z")
    until(lambda: "reference" in page.tab.inner_text("#left-title"), "the reference again", page.tab)
    page.shown("map", "confidence")
    page.tab.keyboard.press("Control+z")
    page.shown("map", "disparity")


def test_words_of_others_in_the_address_do_no_harm(browser: Any, viewer: Viewer) -> None:
    for word in ("nonsense", "%7B%22view%22%3A999%2C%22pixel%22%3A%5B-3%2C9999%5D%2C%22result%22%3A%22none%22%7D", "%"):
        page = Page(browser, viewer)
        page.tab.goto(f"{viewer.url}#{word}")
        page.tab.reload()
        page.shown("map", "disparity")
        page.shown("view", "view")
        page.close()
