"""The EPI and the pointer as instruments, costs at a pixel, maps beside and minus each other, and parts that move."""

from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest
from scipy import ndimage

from lfgpu.data import DisparityMap, LightField
from lfgpu.pipelines.estimate import estimate_depth
from lfgpu.viewer import Viewer, probe
from lfgpu.viewer.contents import Contents, Entry
from lfgpu.viz.colours import painted
from tests.browser import until
from tests.viewer.page import GREY, SIZE, Page, marked, viridis


def test_costs_are_least_at_the_truth_and_hidden_views_are_told(lf: LightField) -> None:
    """Every value beside one pixel by hand; and views in which a near square stands before a far wall."""
    truth = lf.reference_truth()
    found = probe.costs(Contents(lf, {"a": Entry(DisparityMap(truth.disparity))}), "a", "final", 30, 20)
    tried, mean = np.array(found["disparities"]), np.array(found["mean"])
    assert abs(tried[np.argmin(mean)] - truth.disparity[20, 30]) < 0.15
    zero = int(np.argmin(np.abs(tried)))
    shift = tried[zero]
    views = lf.views.astype(float)
    expected = []
    y, x = np.mgrid[19:22, 29:32]
    for index, (du, dv) in enumerate(lf.offsets):
        if index != lf.reference_index:
            place = (y - shift * dv, x - shift * du)
            there = [ndimage.map_coordinates(views[index, ..., c], place, order=1) for c in range(3)]
            expected.append(np.abs(np.stack(there, axis=-1) - views[lf.reference_index, y, x]).mean())
    assert mean[zero] == pytest.approx(np.mean(expected), rel=1e-6)
    disparity = np.full(SIZE, -1.0, np.float32)
    disparity[10:30, 20:30] = 3.0
    hidden = probe.costs(Contents(lf, {"a": Entry(DisparityMap(disparity))}), "a", "final", 32, 20)["hidden"]
    # in the view two to the left the square is six pixels farther right, and the point two farther left
    assert set(hidden) == {n for n, (du, _) in enumerate(lf.offsets) if 20 - 3 * du <= 32 + du < 30 - 3 * du}


def test_a_line_is_measured(page: Page, viewer: Viewer, lf: LightField) -> None:
    """The profile, the distance in space and the box are those of the map; the line is drawn where it is measured."""
    disparity, geometry = viewer.contents.entries["fast"].disparity, lf.geometry
    page.click("map", 10, 30)
    page.tab.mouse.move(5, 5)  # so that the readout is of what is chosen, not of what is under the pointer
    page.reads("chosen x, y 10, 30")
    page.tab.keyboard.press("l")
    page.click("map", 40, 20)
    box = disparity[20:31, 10:41]
    points = geometry.points(disparity, position=tuple(lf.positions[lf.reference_index]))
    apart = np.linalg.norm(points[20, 40] - points[30, 10])
    page.says(f"line {np.hypot(30, 10):.1f} px; {apart:.4g} m in space; box 31 × 11: ", "#measured")
    page.says(f"mean {box.mean():.3g} ± {box.std():.3g}, median {np.median(box):.3g}".replace("-", "−"), "#measured")
    assert "known" not in page.tab.inner_text("#measured")
    until(lambda: page.key("plot").endswith("10,30,40,20"), "the profile is drawn", page.tab)
    page.tab.mouse.move(5, 5)
    page.still()
    for name in ("map", "view"):
        red, green, blue = page.at(name, 25, 25)
        assert red > 180 > 100 > green < blue, name  # the line
    found = probe.span(viewer.contents, disparity, viewer.contents.entries["fast"], "final", [(10, 30), (40, 20)], "")
    at = [disparity[round(30 - k / 3), 10 + k] for k in range(31)]
    np.testing.assert_allclose(found["values"], at)
    np.testing.assert_allclose(found["along"], np.hypot(30, 10) * np.arange(31) / 30)
    page.tab.mouse.move(*page.spot("map", 14, 6))  # across the hole
    page.tab.keyboard.down("Shift")
    page.tab.mouse.down()
    page.tab.mouse.move(*page.spot("map", 14, 10), steps=3)
    page.tab.mouse.up()
    page.tab.keyboard.up("Shift")
    page.says("line 4.0 px", "#measured")
    page.says("60 % of the box known", "#measured")
    page.tab.keyboard.press("Escape")
    until(lambda: not page.tab.locator("#measured").is_visible(), "the measure is gone", page.tab)


def test_the_last_choice_stays_whichever_is_answered_first(page: Page) -> None:
    held: list[Any] = []

    def answer(route: Any) -> None:
        """Hold the answer to the first choice back."""
        if "x=10&y=30&" in route.request.url and not held:
            held.append(route)
        else:
            route.continue_()

    page.tab.mouse.move(*page.spot("map", 10, 30))
    page.reads("10, 30")  # of the pixel under the pointer, which is asked for, too
    page.tab.route("**/data/at?*", answer)
    page.tab.mouse.down()
    page.tab.mouse.up()
    until(lambda: held, "the choice is asked for", page.tab)
    page.click("map", 40, 20)
    page.tab.mouse.move(5, 5)
    page.reads("chosen x, y 40, 20")
    with page.tab.expect_response("**/data/at?x=10&y=30&*"):
        held[0].continue_()
    page.still()
    page.reads("chosen x, y 40, 20")
    page.tab.unroute("**/data/at?*")


def test_an_estimate_is_seen_around_the_pixel(page: Page, viewer: Viewer, lf: LightField) -> None:
    """The hole of the map is filled by the preview, with the values of an estimate; nothing is added to the maps."""
    page.click("map", 30, 30)
    page.choose("preset", "fast")
    names = list(viewer.contents.entries)
    assert page.at("map", 14, 6) == GREY
    page.tab.check("#preview")
    until(lambda: page.at("map", 14, 6) != GREY, "the preview is drawn", page.tab)
    span = viewer.contents.entries["fast"].result.disparity_range  # type: ignore[union-attr]
    limits = viewer.contents.limits("disparity")
    once = estimate_depth(lf, config="fast", disparity_range=span, check_cameras=False).disparity
    np.testing.assert_allclose(page.at("map", 14, 6), viridis(once[6, 14], limits), atol=1)
    page.tab.uncheck("#find-range")
    for name, value in (("from", "-2"), ("to", "-1")):
        page.tab.fill(f"#{name}", value)
        page.tab.locator(f"#{name}").blur()
    again = estimate_depth(lf, config="fast", disparity_range=(-2, -1), check_cameras=False).disparity
    y, x = np.unravel_index(np.argmax(np.abs(again - once)[5:-5, 5:-5]), (SIZE[0] - 10, SIZE[1] - 10))
    wanted = viridis(again[y + 5, x + 5], limits)
    until(lambda: np.abs(np.subtract(page.at("map", x + 5, y + 5), wanted)).max() <= 1, "it has changed", page.tab)
    assert np.abs(np.subtract(viridis(once[y + 5, x + 5], limits), wanted)).max() > 50
    page.tab.check("#find-range")
    page.tab.uncheck("#preview")
    until(lambda: page.at("map", 14, 6) == GREY, "the map is there again", page.tab)
    assert list(viewer.contents.entries) == names


def test_dragging_an_epi_tests_a_disparity(page: Page, viewer: Viewer, lf: LightField) -> None:
    page.click("view", 20, 30)
    until(lambda: page.key("epi-row").endswith(" 30"), "the EPI of the row has come", page.tab)
    page.still()
    left, _, scale = page.place("view")
    box = page.tab.locator("#epi-row").bounding_box()
    row = box["height"] / len(lf.row())
    x = box["x"] + left + (20.5 - 1.5 * 2) * scale  # of disparity 1.5, in the last view of the row
    page.drag((box["x"] + left + 20.5 * scale, box["y"] + 4.5 * row), (x, box["y"] + 4.5 * row))
    page.tab.mouse.move(5, 5)

    def tested() -> float:
        said = page.readout().replace("−", "-").partition("tested ")[2].split()
        return float(said[0]) if said else 0.0

    until(lambda: tested() == pytest.approx(1.5, abs=0.05), "a disparity is tested", page.tab)
    page.still()
    picture = page.pixels("epi-row")
    at = left + (20.5 + 1.5 * 2) * scale
    assert (picture[int(0.5 * row), int(at) - 2 : int(at) + 3] > 240).all(axis=1).any()  # the line in the first view
    until(lambda: "costs" in page.key("plot"), "the costs are drawn", page.tab)
    assert marked(page)() != []
    page.tab.keyboard.press("Escape")
    until(lambda: "tested" not in page.readout(), "the test has ended", page.tab)
    page.tab.click("#plot-tabs [data-value=values]")


def test_a_difference_is_a_map_with_its_distribution_and_shares(browser: Any, lf: LightField) -> None:
    truth = lf.truth
    by = np.where(np.arange(SIZE[1]) < 12, 0.5, 0.02).astype(np.float32)
    with Viewer(lf, DisparityMap(truth.disparity + by), port=0) as viewer, Page(browser, viewer) as page:
        page.shown("map", "disparity")
        page.choose("other", "ground truth")
        page.tab.click("#compare [data-value=minus]")
        page.shown("map", "minus")
        page.says("25 % > 0.07, 25 % > 0.03, 100 % > 0.01", "#right-title")
        until(lambda: "minus" in page.key("histogram"), "its distribution is drawn", page.tab)
        page.shown("map", "RdBu_r -0.07 0.07")
        assert page.at("map", 4, 30) == pytest.approx((103, 0, 31), abs=2)  # the end of the scale
        wanted = painted(np.full((1, 1), 0.02, np.float32), "RdBu_r", (-0.07, 0.07))[0, 0]
        assert page.at("map", 40, 30) == pytest.approx(wanted, abs=3)
        asked = next(url for url in reversed(page.asked) if "data/map" in url and "minus" in url)
        with urlopen(asked, timeout=10) as answer:
            values = np.frombuffer(answer.read(), np.float32).reshape(SIZE)
        np.testing.assert_allclose(values, np.broadcast_to(by, SIZE), atol=1e-5)


def test_four_maps_stand_beside_each_other_with_one_pointer(browser: Any, lf: LightField) -> None:
    truth = lf.truth
    with Viewer(lf, port=0) as viewer:
        for name in "abc":
            viewer.add(DisparityMap(truth.disparity), name=name)
        page = Page(browser, viewer, width=1600, height=1000)
        page.shown("map", "disparity")
        page.choose("result", "a")
        for field, name in (("other", "b"), ("third", "c"), ("fourth", "ground truth")):
            page.choose(field, name)
            page.tab.click("#compare [data-value=side]")
        for name in ("map", "other-map", "third-map", "fourth-map"):
            page.shown(name, "disparity")
        boxes = [page.tab.locator(f"#{name}-map").bounding_box() for name in ("other", "third", "fourth")]
        assert all(box["width"] > 380 for box in boxes)
        assert not page.tab.locator("#view").is_visible()
        before = page.pixels("fourth-map")
        page.tab.mouse.move(*page.spot("map", 40, 30))
        until(lambda: (page.pixels("fourth-map") != before).any(), "the pointer is seen there, too", page.tab)
        left, top, scale = page.place("fourth-map")
        moved = np.argwhere((page.pixels("fourth-map") != before).any(axis=2)).mean(axis=0)
        assert moved == pytest.approx((top + 30.5 * scale, left + 40.5 * scale), abs=2)
        page.tab.keyboard.press("x")
        until(lambda: page.tab.locator("#view").is_visible(), "the views are there again", page.tab)
        page.close()


@pytest.mark.parametrize(("width", "height"), [(1366, 650), (1600, 1000), (3840, 2160)])
def test_views_and_maps_have_one_scale_and_dividers_move(browser: Any, viewer: Viewer, width: int, height: int) -> None:
    page = Page(browser, viewer, width=width, height=height)
    page.shown("map", "disparity")
    page.shown("view", "view")
    assert page.place("view")[2] == pytest.approx(page.place("map")[2], rel=0.02)
    before = page.tab.locator("#right").bounding_box()["width"]
    box = page.tab.locator(".gutter[data-name=left]").bounding_box()
    page.drag((box["x"] + 2, box["y"] + 200), (box["x"] - 120, box["y"] + 200))
    assert page.tab.locator("#right").bounding_box()["width"] == pytest.approx(before + 122, abs=6)
    page.tab.dblclick(".gutter[data-name=aside]")
    assert page.tab.locator("#settings").bounding_box()["width"] < 5
    among, least = page.place("map")[2], 0.75 * (height - 120) / SIZE[0]
    page.tab.click("#alone")
    page.shown("map", "disparity")
    assert page.tab.locator("#right").bounding_box()["width"] > width - 20
    page.moved("map", lambda place: place[2] > max(among, least), "alone, the map is larger and fills the pane")
    assert page.tab.evaluate("(e => e.scrollWidth <= e.clientWidth)(document.getElementById('results'))")
    page.tab.click("#plot-tabs [data-value='']")
    until(lambda: not page.tab.locator("#histogram").is_visible(), "the distribution is folded", page.tab)
    assert page.tab.evaluate("document.documentElement.scrollWidth") <= width
    page.close()


def test_handles_of_the_distribution_set_the_range_and_so_does_what_is_seen(page: Page, viewer: Viewer) -> None:
    low, high = viewer.contents.limits("disparity")
    until(lambda: "disparity" in page.key("histogram"), "the distribution is drawn", page.tab)
    box = page.tab.locator("#histogram .u-over").bounding_box()
    ends = [float(x) for x in page.key("histogram").split()[-3:-1]]

    def at(value: float) -> float:
        return float(box["x"] + (value - ends[0]) / (ends[1] - ends[0]) * box["width"])

    page.drag((at(high), box["y"] + 20), (at((low + high) / 2), box["y"] + 20))
    until(lambda: float(page.tab.input_value("#high")) == pytest.approx((low + high) / 2, abs=0.1), "set", page.tab)
    page.enlarge("map", 40, 30, 5, 300)
    page.moved("map", lambda place: place[2] > 38, "the map is enlarged")
    page.tab.click("#seen")
    part = viewer.contents.entries["fast"].disparity[26:36, 34:46]
    least, most = float(np.nanmin(part)) - 0.3, float(np.nanmax(part)) + 0.3

    def is_of_part() -> bool:
        return float(page.tab.input_value("#low")) >= least and float(page.tab.input_value("#high")) <= most

    until(is_of_part, "the range of what is seen", page.tab)
    page.tab.click("#auto")


def test_pixels_that_are_large_enough_have_their_values_on_them(page: Page, viewer: Viewer) -> None:
    page.enlarge("map", 40, 30, 6, 300)
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
        said = page.readout().partition("colour ")[2].split()[:3]
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
