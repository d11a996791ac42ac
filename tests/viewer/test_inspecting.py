"""Values on pixels that are large enough, colours at the pointer, and a form for parameters that helps."""

import numpy as np

from lfgpu.data.lightfield import LightField
from lfgpu.viewer import Viewer
from tests.browser import until
from tests.viewer.page import Page, viridis


def test_pixels_that_are_large_enough_have_their_values_on_them(page: Page, viewer: Viewer) -> None:
    page.tab.mouse.move(*page.spot("map", 40, 30))
    for _ in range(6):
        page.tab.mouse.wheel(0, -300)
    page.moved("map", lambda place: place[2] > 60, "the map is enlarged")
    picture = page.shown("map", "disparity")
    left, top, scale = page.place("map")
    disparity, limits = viewer.contents.entries["fast"].disparity, viewer.contents.limits("disparity")
    part = picture[int(top + 30 * scale) : int(top + 31 * scale), int(left + 40 * scale) : int(left + 41 * scale)]
    assert (part.reshape(-1, 3) > 235).all(axis=1).sum() > 5  # letters, in white
    assert (part.reshape(-1, 3) < 40).all(axis=1).sum() > 20  # with a dark outline
    np.testing.assert_allclose(part[3, 3], viridis(disparity[30, 40], limits), atol=1)


def test_the_pointer_says_the_stored_colour(page: Page, lf: LightField) -> None:
    page.tab.mouse.move(*page.spot("view", 33, 7))
    expected = [float(value) for value in lf.views[lf.reference_index, 7, 33]]

    def colour() -> list[float]:
        said = page.readout().replace("\n", " ").partition("colour ")[2].split()[:3]
        return [float(word) for word in said if word.replace(".", "").isdigit()]

    until(lambda: colour() == expected, f"the colour is {expected}; {page.readout()!r}", page.tab)


def test_parameters_are_searched_explained_and_checked(page: Page) -> None:
    page.tab.evaluate("document.getElementById('parameters').open = true")
    page.choose("preset", "accurate")
    page.tab.fill("#parameter-search", "iterations")
    field = page.tab.locator('[data-name="alignment.iterations"]')
    assert field.is_visible()
    assert not page.tab.locator('[data-name="sweep.softness"]').is_visible()
    assert " to " in field.locator("small").inner_text()
    for text, is_wrong in (("many", True), ("3", False), ("-7", True), ("2.5", True), ("4", False)):
        field.locator("input").fill(text)
        assert ("wrong" in str(field.get_attribute("class")).split()) == is_wrong, text
    page.tab.fill("#parameter-search", "")
    page.tab.click("#reset")
