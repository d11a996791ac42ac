"""The page on dark and light systems and on phones, each tab with its own settings, and its help."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu.io import load
from lfgpu.viewer import Viewer
from tests.viewer.page import Page


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
        phone.tab.wait_for_selector(shown)  # a tap returns before the browser makes a click of it
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


def test_help_and_what_cannot_be_opened(page: Page) -> None:
    page.tab.keyboard.press("?")
    assert page.tab.locator("#help").is_visible()
    assert "wheel" in page.tab.inner_text("#help").lower()
    page.tab.keyboard.press("Escape")
    page.tab.click("#open-files")
    page.tab.fill("#path", "/no/such/place")
    page.tab.press("#path", "Enter")
    page.says("/no/such/place does not exist")


def test_dialogs_begin_where_people_type_and_help_fits(browser: Any, page: Page, viewer: Viewer) -> None:
    for key, field in (("s", "save-name"), (None, "path")):
        page.tab.keyboard.press(key) if key else page.tab.click("#open-files")
        assert page.tab.evaluate("document.activeElement.id") == field
        page.tab.keyboard.press("Escape")
    page.tab.keyboard.press("?")
    assert page.tab.locator(".keys").is_visible()
    assert page.tab.evaluate("(e => e.scrollHeight <= e.clientHeight)(document.getElementById('help'))")
    phone = Page(browser, viewer, width=390, height=844, has_touch=True, is_mobile=True)
    phone.tab.tap("#open-help")
    phone.tab.wait_for_selector("#help")  # a tap returns before the browser makes a click of it
    assert not phone.tab.locator(".keys").is_visible()  # it has none
    phone.close()


def test_long_names_leave_room_for_the_scores(browser: Any, files: Path) -> None:
    with Viewer.of([files / "boxes"], port=0) as viewer:
        result = load(files / "fast")
        for name in ("a name that is far longer than there is room for in the table of the page", "fast"):
            viewer.add(result, name=name)
        for width in (390, 1100, 1366, 1600):
            page = Page(browser, viewer, width=width, height=844)
            page.tab.wait_for_selector("#right", state="attached")
            if width == 390:
                page.tab.click("nav [data-value=map]")
            page.tab.wait_for_selector("#scores", state="visible")
            page.shown("map", "disparity")
            box = page.tab.locator("#results")
            assert box.evaluate("e => e.scrollWidth <= e.clientWidth"), width
            assert page.tab.locator("#scores tbody td").first.bounding_box()["width"] > 40
            page.close()
