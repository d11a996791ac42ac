"""Processed Lytro containers: their views, and what is said where there is no light field."""

import copy
from pathlib import Path
from typing import Any

import lytro_samples
import numpy as np
import pytest
from conftest import real_data
from fields import SAMPLES, scene
from lenslet_samples import container, metadata, packed
from samples import refusal

from lfgpu.io import parallax, read, recognise
from lfgpu.io.lytro import inside
from lfgpu.io.lytro.container import open_container
from lfgpu.io.lytro.contents import read_contents

IMAGES = np.random.default_rng(0).integers(0, 256, (3, 16, 24, 3), np.uint8)


def write(folder: Path, data: bytes, name: str = "a.lfp") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def of_views(coordinates: list[tuple[float, float]]) -> tuple[dict[str, Any], list[bytes]]:
    images = np.random.default_rng(1).integers(0, 256, (len(coordinates), 16, 24, 3), np.uint8)
    return lytro_samples.pictures(images, [{"coord": {"x": x, "y": y}} for x, y in coordinates])


HEXAGON = [(0.0, 0.0), *((0.2 * np.cos(a), 0.2 * np.sin(a)) for a in np.radians(range(30, 390, 60)))]


def test_views_of_a_hexagonal_lattice(tmp_path: Path) -> None:
    content, data = of_views(HEXAGON)
    path = write(tmp_path, lytro_samples.processed([("edofParallax", content)], data))
    found = read(path)
    assert recognise(path)[0].name == "lytro"
    assert (found.reference, found.grid_shape, found.size) == (0, None, (16, 24))
    np.testing.assert_allclose(np.hypot(*found.offsets[1:].T), 1)
    np.testing.assert_allclose(found.offsets[1], [np.sqrt(3) / 2, 0.5])
    assert found.notes[0] == "One view step is 0.2 in Lytro's unit, the distance of neighbouring views."


def test_a_focal_stack_is_said_to_be_one(tmp_path: Path) -> None:
    content, data = lytro_samples.focal_stack(IMAGES)
    path = write(tmp_path, lytro_samples.processed([("refocusStack", content)], data, camera=lytro_samples.CAMERA))
    said = inside(path)
    facts = dict(said.facts)
    assert facts["contents"] == "a focal stack"
    assert facts["camera"] == "Lytro, Inc. F01, 2015-05-05T10:07:34.000Z"
    assert facts["lens"] == "6.53 mm, f/1.91, 0.0125 s, ISO 100"
    assert facts["microlenses"].startswith("10 px apart, turned by 0.109 degrees")
    assert said.no_depth is not None
    text = refusal(lambda: read(path))
    for sentence in (text, said.no_depth):
        assert "all show the scene from one place" in sentence
        assert "give the container with the raw picture" in sentence


def test_the_illum_says_it_in_other_words(tmp_path: Path) -> None:
    path = write(tmp_path, lytro_samples.of_illum({"kind": "focusStack"}, [], camera=lytro_samples.CAMERA), "a.LFP")
    contents = read_contents(path)
    assert contents.summary() == "a focal stack"
    assert contents.camera.microlenses is not None
    assert "from one place" in refusal(lambda: read(path))


def test_a_raw_picture_goes_before_what_was_computed_from_it(tmp_path: Path) -> None:
    data = container(packed(np.zeros((8, 20), np.uint16), 12), {**metadata((8, 20)), **lytro_samples.CAMERA})
    path = write(tmp_path, data)
    assert recognise(path)[0].name == "lenslet"
    facts = dict(inside(path).facts)
    assert facts["contents"] == "a raw picture"
    assert inside(path).no_depth is None
    path = write(tmp_path, lytro_samples.processed([("depthMap", {})], []))
    text = refusal(lambda: read(path))
    assert f"the raw picture '{lytro_samples.LOST}' that it names is not in this file" in text
    assert "has no raw picture" in refusal(lambda: read(path, format="lenslet"))


# --- real files ---


@pytest.mark.parametrize(
    ("name", "contents"),
    [
        ("IMG_0001-stk.lfp", "a focal stack"),
        ("IMG_0002-dm.lfp", "a depth table"),
        ("flowers-stk.lfp", "a focal stack"),
        ("buddha.lfp", "a focal stack"),
        ("illum_demo.LFP", "a focal stack"),
    ],
)
def test_real_containers_without_views(name: str, contents: str) -> None:
    file = real_data(f"real/lytro/{name}")
    assert recognise(file)[0].name == "lytro"
    said = inside(file)
    assert dict(said.facts)["contents"] == contents
    assert said.no_depth is not None
    assert said.no_depth in refusal(lambda: read(file))


def test_real_views_run_against_lytros_depth() -> None:
    pytest.importorskip("imageio_ffmpeg")
    found = read(real_data("real/lytro/IMG_0002-stk.lfp"))
    assert found.views.shape == (37, 1080, 1080, 3)
    assert found.offsets[found.reference_index].tolist() == [0, 0]
    np.testing.assert_allclose(np.sort(np.hypot(*found.offsets.T))[:8], [0, 1, 1, 1, 1, 1, 1, np.sqrt(3)], atol=1e-6)
    assert parallax.axes_agree(found) is True
    container = open_container(real_data("real/lytro/IMG_0002-dm.lfp"))
    name = next(name for name, section in container.sections.items() if section.length == 4 * 330 * 330)
    table = np.frombuffer(container.data(name), "<f4").reshape(330, 330)  # λ, larger is farther
    for axis in (0, 1):
        measured = parallax.measured(found, axis)
        assert measured is not None
        disparity, weight = measured
        places = [(np.arange(side) + 0.5) * 330 / side for side in disparity.shape]
        there = table[np.ix_(*(np.floor(place).astype(int) for place in places))]
        assert parallax.agreement(disparity, -there.astype(float), weight) > 0.8


# --- damage ---


def change(content: dict[str, Any], keys: str, value: Any) -> dict[str, Any]:
    """A copy with another value at "a.0.b"."""
    changed = copy.deepcopy(content)
    *parents, last = [int(key) if key.isdigit() else key for key in keys.split(".")]
    place: Any = changed
    for parent in parents:
        place = place[parent]
    place[last] = value
    return changed


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        ("imageArray.0.imageRef", "sha1-x", "its imageRef names 'sha1-x', and there is no such section"),
        ("imageArray.0.imageRef", None, "its imageRef names 'None'"),
        ("imageArray.0.width", 25, "pictures of several sizes or kinds"),
        ("imageArray.0.width", 10**9, "imageArray[0].width = 1000000000, not a number from 8 to 16384"),
        ("imageArray.1.representation", "jpeg", "pictures of several sizes or kinds"),
        ("imageArray.0.coord", 3, "a JSON int for picture.accelerationArray[0].vendorContent.imageArray[0].coord"),
        ("imageArray.0.coord.x", 1e6, "vendorContent.imageArray[0].coord.x = 1000000.0"),
        ("imageArray.0.coord.x", float("nan"), "coord.x = nan"),
        ("imageArray", [], "has no pictures"),
        ("imageArray", [3], "has no list of objects"),
        (
            "imageArray",
            {},
            "vendorContent.imageArray, where a list should be",
        ),
    ],
)
def test_descriptions_of_views_that_cannot_be(keys: str, value: Any, words: str, tmp_path: Path) -> None:
    content, data = of_views(HEXAGON)
    content = change(content, keys, value)
    path = write(tmp_path, lytro_samples.processed([("edofParallax", content)], data))
    assert words in refusal(lambda: read(path, format="lytro"))


def test_pictures_that_are_not_what_they_are_said_to_be(tmp_path: Path) -> None:
    content, data = of_views(HEXAGON)

    def says(content: dict[str, Any], words: str, data: list[bytes] = data) -> None:
        path = write(tmp_path, lytro_samples.processed([("edofParallax", content)], data))
        assert words in refusal(lambda: read(path))

    larger = copy.deepcopy(content)
    for entry in larger["imageArray"]:
        entry["width"] = 48
    says(larger, "a picture in it is 24 x 16 px, where it says 48 x 16")
    for entry in larger["imageArray"]:
        entry.update(width=16384, height=16384)
    says(larger, "claims 805306368 bytes of pixels")
    other = copy.deepcopy(content)
    for entry in other["imageArray"]:
        entry["representation"] = "jpeg"
    says(other, "a picture in it cannot be read (it is not jpeg)")
    for entry in other["imageArray"]:
        entry["representation"] = "webp"
    says(other, "pictures stored as 'webp'; known are jpeg, png and h264")
    one_place, more = of_views([(0, 0), (0, 0), (0, 0)])
    says(one_place, "several of its views stand in one place", more)
    alone, more = of_views([(0, 0)])
    says(alone, "one view only", more)


def test_videos_that_are_not_what_they_are_said_to_be(tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    lf = scene((3, 3), (36, 34))
    good = SAMPLES["lytro"].write(lf, tmp_path)
    contents = read_contents(good)
    name = contents.views.sections[0]
    stream = contents.container.data(name)

    def says(words: str, data: bytes = stream, size: tuple[int, int] = lf.size, count: int = 9) -> None:
        each = [{"coord": {"x": 0.1 * i, "y": 0}} for i in range(count)]
        content, sections = lytro_samples.video(data, size, each)
        path = write(tmp_path, lytro_samples.processed([("edofParallax", content)], sections))
        assert words in refusal(lambda: read(path))

    says("says that its video has 10 pictures, it has 9", count=10)
    says("says that its video has 8 pictures, it has more", count=8)
    says("a picture in it is 34 x 36 px, where it says 40 x 40", size=(40, 40))
    says("cannot be read as a video", data=b"no video" * 100)


def test_unknown_accelerations_are_named(tmp_path: Path) -> None:
    path = write(tmp_path, lytro_samples.processed([("hologram", {})], []))
    assert "an acceleration 'hologram', which is not known" in refusal(lambda: read(path))
