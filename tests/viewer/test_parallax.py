"""A camera between the views: what it sees is what a camera there would have seen."""

from dataclasses import replace
from typing import Any

import numpy as np

from lfgpu import scenes
from lfgpu.data import DisparityMap, LightField
from lfgpu.viewer import Viewer
from tests.browser import until
from tests.viewer.page import Page

SIZE = (96, 96)
RIGHT = 3  # pixels at the borders that other views may not show


def sparse() -> tuple[LightField, LightField]:
    """A light field, and the same without every second row and column of views."""
    whole = scenes.make("boxes", grid=(9, 9), size=SIZE)
    kept = (whole.positions % 2 == 0).all(axis=1)
    few = LightField(
        whole.views[kept],
        whole.positions[kept],
        reference=int(np.flatnonzero(np.flatnonzero(kept) == whole.reference_index)[0]),
        name="every second one",
    )
    return whole, few


def drag(page: Page, du: float, dv: float, aperture: float) -> None:
    """Drag the view so that its camera moves by view steps."""
    scale = page.place("view")[2]
    x, y = page.spot("view", 48, 48)
    by = [-step * scale * side / (2 * aperture) for step, side in ((du, SIZE[1]), (dv, SIZE[0]))]
    page.drag((x, y), (x + by[0], y + by[1]))


def seen(page: Page) -> np.ndarray:
    """The pixels of the view, one of each of its squares."""
    left, top, scale = page.place("view")
    rows, columns = (
        (start + (np.arange(side) + 0.5) * scale).astype(int) for start, side in ((top, SIZE[0]), (left, SIZE[1]))
    )
    return page.pixels("view")[np.ix_(rows, columns)].astype(int)


def test_it_sees_what_a_camera_there_would_see(browser: Any) -> None:
    whole, few = sparse()
    truth = whole.reference_truth()
    with (
        Viewer(few, DisparityMap(truth.disparity), port=0) as viewer,
        Page(browser, viewer, width=1600, height=1000) as page,
    ):
        page.shown("view", "view")
        drag(page, 1.0, -1.0, float(np.hypot(4, 4)))
        until(lambda: "Camera (+1, −1)" in page.tab.inner_text("#left-title"), "it is there", page.tab)
        page.shown("view", "camera")
        until(lambda: len({url for url in page.asked if "data/view" in url}) == len(few.views), "all come", page.tab)
        page.tab.wait_for_timeout(500)
        expected = whole.views[whole.index_of(3, 5)].astype(int)
        nearest = [few.views[few.index_of(v, u)].astype(int) for v, u in ((4, 4), (2, 4), (4, 6), (2, 6))]
        inner = np.s_[RIGHT:-RIGHT, RIGHT:-RIGHT]
        found = seen(page)
        far = [np.abs(view - expected)[inner].mean() for view in (found, *nearest)]
        assert far[0] < 0.4 * min(far[1:]), far
        page.tab.keyboard.press("ArrowRight")
        page.shown("view", "view")
        assert "column" in page.tab.inner_text("#left-title")


def test_without_a_map_the_camera_goes_from_view_to_view(browser: Any, lf: LightField) -> None:
    with Viewer(replace(lf, truth=None), port=0) as viewer, Page(browser, viewer) as page:
        page.shown("view", f" {lf.reference_index} ")
        x, y = page.spot("view", 24, 20)
        page.drag((x, y), (x - 400, y))
        page.shown("view", f" {lf.index_of(2, 4)} ")


def test_it_sways_by_a_key_and_stops_at_a_touch(page: Page) -> None:
    page.tab.keyboard.press("w")
    page.shown("view", "camera")
    first = page.key("view")
    until(lambda: page.key("view") != first, "the camera moves", page.tab)
    page.tab.mouse.move(300, 300)
    page.shown("view", "view")
    assert "reference" in page.tab.inner_text("#left-title")
    page.tab.keyboard.press("w")


def test_dark_captures_are_shown_brighter(browser: Any, lf: LightField) -> None:
    dark = replace(lf, views=(lf.views / 8).astype(np.uint8), truth=None)
    with Viewer(dark, port=0) as viewer, Page(browser, viewer) as page:
        bright = page.shown("view", "view")
        stops = float(page.tab.input_value("#exposure"))
        assert 2 < stops < 4
        stored = dark.views[lf.reference_index, 30, 4].astype(float)
        np.testing.assert_allclose(page.at("view", 4, 30), np.minimum(255, stored * 2**stops), atol=1)
        assert bright.max() > 200
