"""A page of its own: opened from a file, without a server and a network, it shows the same sight."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu.data.lightfield import LightField
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
    until(lambda: "33, 12" in page.readout(), "the pixel is chosen", page.tab)
    expected = page.shown("map", "minus").astype(int)
    readout = page.readout().replace("\n", " ").split()
    page.tab.wait_for_timeout(700)
    page.tab.keyboard.press("s")
    page.tab.fill("#save-name", "supplement")
    with page.tab.expect_download() as download:
        page.tab.click("#save-page")
    assert download.value.suggested_filename == "supplement.html"
    download.value.save_as(tmp_path / "supplement.html")
    text = (tmp_path / "supplement.html").read_text()
    assert viewer.url not in text
    assert 'src="' not in text.split("<body")[0]
    alone = Page(browser, File(tmp_path / "supplement.html"), offline=True)
    found = alone.shown("map", "minus").astype(int)
    until(lambda: "33, 12" in alone.readout(), "the pixel is chosen", alone.tab)
    assert alone.place("map")[2] == pytest.approx(page.place("map")[2], rel=0.1)
    for x, y in ((4, 30), (44, 8), (24, 36)):
        at = [one.at("map", x, y) for one in (page, alone)]
        assert at[0] == pytest.approx(at[1], abs=3)
    assert len(found) > 0 < len(expected)
    words = [word for word in readout if word.isalpha() and word != "colour"]  # that of compressed views is not stored
    assert [word for word in alone.readout().replace("\n", " ").split() if word.isalpha()] == words
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
    from PIL import Image

    page.tab.keyboard.press("s")
    page.choose("save-times", "4")
    with page.tab.expect_download() as download:
        page.tab.click("#save-view")
    download.value.save_as(tmp_path / "view.png")
    page.choose("save-times", "1")
    with Image.open(tmp_path / "view.png") as image:
        found = np.asarray(image.convert("RGB"))
    np.testing.assert_array_equal(found, lf.views[lf.reference_index].repeat(4, axis=0).repeat(4, axis=1))
