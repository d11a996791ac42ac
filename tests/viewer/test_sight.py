"""The address of the page holds what is shown; changes can be taken back."""

from typing import Any

from lfgpu.viewer import Viewer
from tests.browser import until
from tests.viewer.page import Page


def test_a_link_opens_the_same_sight(browser: Any, page: Page, viewer: Viewer) -> None:
    page.choose("other", "ground truth")
    page.tab.click("#compare [data-value=minus]")
    page.click("map", 33, 12)
    page.tab.keyboard.press("ArrowRight")
    page.tab.mouse.move(*page.spot("map", 30, 20))
    for _ in range(3):
        page.tab.mouse.wheel(0, -200)
    page.shown("map", "minus")
    page.tab.mouse.move(5, 5)
    until(lambda: "33, 12" in page.readout(), "the pixel is chosen", page.tab)
    page.tab.wait_for_timeout(900)
    address = page.tab.url
    assert "minus" in address
    again = Page(browser, viewer)
    again.tab.goto(address)
    again.tab.reload()
    again.shown("map", "minus")
    until(lambda: "33, 12" in again.readout(), "the pixel is chosen", again.tab)
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
