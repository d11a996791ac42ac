"""A glance at cameras without a map; and what `info` and `batch` say of them by themselves."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu import scenes
from lfgpu._backends import open_device
from lfgpu.calibration import Misalignment, disturb
from lfgpu.cameras.looking import look, part_of
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.io import write_hci
from lfgpu.pipelines.verdict import judged


def glance(lf: LightField) -> str | None:
    """The first finding of a look without a map."""
    found = look(lf, None, open_device("warp", "cpu"), budget="screen")
    return found.findings[0] if found is not None and found.findings else None


DATA = Path(os.environ.get("LFGPU_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.fixture(scope="module")
def boxes() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(128, 144), seed=3, noise=0.004)


@pytest.mark.parametrize(("how", "words"), [("shift=0.5", "out of line by 0."), ("gain=0.15", "differ in brightness")])
def test_what_is_wrong_with_all_cameras_is_seen_at_a_glance(boxes: LightField, how: str, words: str) -> None:
    assert glance(boxes) is None
    found = glance(disturb(boxes, Misalignment.parse(how), seed=1).light_field)
    assert found is not None
    assert words in found


def test_an_axis_that_is_counted_the_wrong_way_is_seen_at_a_glance(boxes: LightField) -> None:
    flipped = replace(boxes, positions=boxes.positions * (1, -1), grid_shape=None, truth=None, geometry=None)
    found = glance(flipped)
    assert found is not None
    assert "opposite senses" in found


def test_a_single_view_is_left_to_the_judge(boxes: LightField) -> None:
    views = boxes.views.copy()
    views[3] = np.roll(views[3], 1, axis=1)
    assert glance(replace(boxes, views=views)) is None


def test_views_that_show_nothing_say_nothing_of_cameras(rng: np.random.Generator) -> None:
    assert glance(LightField.from_grid(np.full((3, 3, 32, 32), 100, np.uint8))) is None
    assert glance(LightField.from_grid(rng.integers(0, 255, (3, 3, 64, 64), dtype=np.uint8))) is None


@pytest.mark.parametrize("name", ["lytro_2067", "stillLife_3x3", "population/C_fence"])
def test_real_cameras_raise_no_alarm(name: str) -> None:
    if not (DATA / name).exists():
        pytest.skip(f"{DATA / name} is not there")
    assert glance(lfgpu.read(DATA / name)) is None


def test_the_part_that_is_looked_at_is_bounded_and_keeps_its_places(boxes: LightField) -> None:
    part, (rows, columns) = part_of(boxes, views=9, pixels=9 * 32 * 36)
    assert part.views.shape == (9, 32, 36, 3)
    assert (part.views[part.reference_index] == boxes.views[12, rows, columns]).all()
    assert part.positions[part.reference_index].tolist() == boxes.positions[12].tolist()
    whole, window = part_of(boxes, views=100, pixels=10**9)
    assert whole is boxes
    assert window == (slice(0, 128), slice(0, 144))


def test_a_quick_judgement_finds_what_all_cameras_have(boxes: LightField) -> None:
    wrong = disturb(boxes, Misalignment(shift=0.5), seed=1).light_field
    result = lfgpu.estimate_depth(wrong, config="fast", disparity_range=(-2, 2), device="cpu")
    quick = judged(wrong, result, device="cpu", in_part=True)
    assert "out of line" in quick.remarks[0]
    assert np.nanmean(quick.confidence) < np.nanmean(result.confidence) - 0.1


@pytest.fixture(scope="module")
def folder(boxes: LightField, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two light fields in a folder: one of which the cameras are out of line, one in which all is right."""
    place = tmp_path_factory.mktemp("recorded")
    write_hci(disturb(boxes, Misalignment(shift=0.5), seed=1).light_field, place / "moved")
    write_hci(boxes, place / "right")
    return place


def test_info_says_it(folder: Path) -> None:
    moved, right = (CliRunner().invoke(app, ["info", str(folder / name)]).stdout for name in ("moved", "right"))
    assert "cameras the views are out of line" in " ".join(moved.split())
    assert "out of line" not in right


def test_batches_keep_it_in_the_manifest_and_on_the_page(folder: Path, tmp_path: Path) -> None:
    options = ["--preset=fast", "--disparity-range=-2,2", "--workers=1", "--device=cpu"]
    outcome = CliRunner().invoke(app, ["batch", str(folder), "-o", str(tmp_path / "out"), *options])
    assert outcome.exit_code == 0, outcome.output
    lines = [json.loads(line) for line in (tmp_path / "out" / "manifest.jsonl").read_text().splitlines()]
    remarks = {line["item"]: line["remarks"] for line in lines if "item" in line}
    assert remarks["right"] == []
    assert "out of line" in remarks["moved"][0]
    assert lfgpu.load(tmp_path / "out" / "moved" / "result.npz").remarks == tuple(remarks["moved"])
    assert "the views are out of line" in (tmp_path / "out" / "report.html").read_text()
