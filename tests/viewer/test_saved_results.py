"""Estimates that the page starts, results and pictures that it saves, maps that it opens."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import colormaps
from PIL import Image

from lfgpu import scenes
from lfgpu.io import load, read_map, write_hci
from lfgpu.viewer import Viewer
from lfgpu.viewer.space import PICTURES, Pose
from tests.browser import until
from tests.viewer.page import GREY, Page


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
    assert result.config.alignment.iterations == 3  # type: ignore[attr-defined]


def test_results_and_pictures_are_saved(page: Page, viewer: Viewer, tmp_path: Path) -> None:
    entry = viewer.contents.entries["fast"]
    page.tab.keyboard.press("s")
    page.tab.fill("#save-name", "my map")
    buttons = {text: page.tab.get_by_role("button", name=text, exact=True) for text in (".npz", ".pfm", ".ply")}
    buttons |= {"map": "#save-map", "with a scale": "#save-figure"}
    saved = {text: page.saved(button, tmp_path) for text, button in buttons.items()}
    names = {"my map.npz", "my map.pfm", "my map.ply", "my map-disparity.png"}
    assert {path.name for path in saved.values()} == names
    result = load(saved[".npz"])
    assert result.config == entry.result.config  # type: ignore[union-attr]
    np.testing.assert_array_equal(read_map(saved[".pfm"]), entry.disparity)
    assert saved[".ply"].read_bytes().startswith(b"ply\n")


def test_saved_maps_have_one_pixel_for_each_and_no_marks(page: Page, viewer: Viewer, tmp_path: Path) -> None:
    entry = viewer.contents.entries["fast"]
    page.tab.keyboard.press("s")
    with Image.open(page.saved("#save-map", tmp_path)) as image:
        found = np.asarray(image.convert("RGB"))
    limits = viewer.contents.limits("disparity")
    share = np.clip((np.nan_to_num(entry.disparity) - limits[0]) / (limits[1] - limits[0]), 0, 1)
    expected = (colormaps["viridis"]((255 * share + 0.5).astype(int))[..., :3] * 255 + 0.5).astype(np.uint8)
    expected[~np.isfinite(entry.disparity)] = GREY
    np.testing.assert_allclose(found.astype(int), expected.astype(int), atol=6)
    assert (np.abs(found.astype(int) - expected) <= 1).mean() > 0.99  # the next step of the colour map here and there


def test_points_are_drawn_and_saved_without_marks(page: Page, tmp_path: Path) -> None:
    page.tab.keyboard.press("d")
    page.choose("space-paint", "confidence")

    page.has_points()
    wide = int(page.tab.locator("#space-frame").bounding_box()["width"])
    page.tab.keyboard.press("s")

    def saved() -> list[np.ndarray]:
        with Image.open(page.saved("#save-space [value=picture]", tmp_path)) as image:
            found = np.asarray(image.convert("RGB")).astype(int)
        return [found] if len(np.unique(found[:, :wide].reshape(-1, 3), axis=0)) > 100 else []

    found = until(saved, "points are in the picture", page.tab)[0]
    assert (found[:3, :3] == 255).all()  # the background of a light page
    for column in (found[:, wide:], page.pixels("space-bar")):  # beside the points stands their scale
        shades = colormaps["cividis"]([0.25, 0.5, 0.75], bytes=True)[:, :3].astype(int)
        assert all((np.abs(column - shade).max(axis=-1) <= 2).sum() > 10 for shade in shades)
    page.says("colour: confidence", "#right-title")
    assert not _pink(found).any()  # there is none in the colours of the confidence
    page.tab.keyboard.press("Escape")
    seen = page.space()
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 100
    assert _pink(seen).any()


def _pink(seen: np.ndarray) -> np.ndarray:
    """Where the mark is seen, as long as nothing else is of its colour."""
    return (seen[..., 0] > 200) & (seen[..., 1] < 120) & (seen[..., 2] > 90)


def test_an_orbit_leads_back() -> None:
    begin = Pose(np.array([0.4, -0.3, -1.0]), np.array([0.1, 0.2, 2.0]), 0.8)
    poses = [begin.orbited(turn) for turn in np.linspace(0, 1, 9)]
    assert [pose.away for pose in poses] == pytest.approx([begin.away] * 9)
    np.testing.assert_allclose([poses[0].eye, poses[4].eye, poses[8].eye], [begin.eye] * 3, atol=1e-12)
    sides = [float((pose.eye - begin.eye) @ begin.axes[:, 0]) for pose in poses]
    assert sides[2] == pytest.approx(begin.away * np.sin(np.radians(20)))
    assert sides[6] == pytest.approx(-sides[2])


@pytest.mark.thorough
def test_films_are_saved_and_the_eye_orbits(browser: Any, viewer: Viewer, tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    page = Page(browser, viewer, width=800, height=420)
    page.shown("map", "disparity")
    page.tab.keyboard.press("d")
    page.has_points()
    seen = page.space
    until(lambda: len(np.unique(seen().reshape(-1, 3), axis=0)) > 100, "points are drawn", page.tab)
    before = seen()
    page.choose("space-paint", "confidence")
    until(lambda: not np.array_equal(seen(), before), "their colours change", page.tab)
    until(lambda: np.array_equal(seen(), seen()), "they have their colours", page.tab)  # before the film begins
    page.tab.keyboard.press("s")
    saved = {form: page.saved(f"#save-space [value={form}]", tmp_path, 300_000) for form in ("gif", "mp4")}
    with Image.open(saved["gif"]) as image:
        assert image.n_frames == PICTURES  # type: ignore[attr-defined]
        frames = []
        for k in range(PICTURES):
            image.seek(k)
            frames.append(np.asarray(image.convert("RGB")).astype(int))
    assert not any(_pink(one).any() for one in frames), "without marks"
    aside, back = (np.abs(frames[k] - frames[0]).mean() for k in (PICTURES // 4, PICTURES // 2))
    assert back < 0.2 * aside, "half way round, the eye is where it began"
    about, *coded = ffmpeg.read_frames(str(saved["mp4"]))
    wide, high = about["size"]
    assert (about["fps"], len(coded)) == (16, PICTURES)
    assert (high, wide) == tuple(side - side % 2 for side in frames[0].shape[:2])
    for one, same in zip(frames, coded, strict=True):
        film = np.frombuffer(same, np.uint8).reshape(high, wide, 3).astype(int)
        assert np.abs(film - one[:high, :wide]).mean() < 0.2 * aside, "both films see the same"
    page.tab.keyboard.press("Escape")
    before = seen()
    page.tab.check("#space-orbit")
    until(lambda: np.abs(seen() - before).mean() > 0.5 * aside, "the eye moves", page.tab)
    page.close()


def test_a_light_field_of_fewer_views_replaces_one_of_more(browser: Any, files: Path, tmp_path: Path) -> None:
    """Also while a view is looked at that the new one has not."""
    write_hci(scenes.make("boxes", grid=(3, 3), size=(30, 44)), tmp_path / "small")
    with Viewer.of([files / "boxes", files / "fast"], port=0, allow_open=True) as viewer, Page(browser, viewer) as page:
        page.shown("map", "disparity")
        page.tab.keyboard.press("ArrowDown")
        page.shown("view", " 17 ")
        page.tab.click("#open-files")
        page.tab.fill("#path", str(tmp_path / "small"))
        page.tab.press("#path", "Enter")
        until(lambda: page.tab.inner_text("#name") == "small", "the other light field is shown", page.tab)
        page.shown("view", " 4 ")
        page.shown("map", "disparity")
        assert "Row 1, column 1" in page.tab.inner_text("#left-title")
        assert "3 × 3 views, 44 × 30 pixels" in page.tab.inner_text("#facts")
