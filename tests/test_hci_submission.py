"""The folder that the HCI benchmark takes, and its measures of regions."""

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from lfgpu.cli import app
from lfgpu.errors import LightFieldError
from lfgpu.io import read_map, write_hci, write_pfm
from lfgpu.io.hci_submission import SCENES, read_region_masks, write_submission
from lfgpu.metrics import evaluate_regions
from lfgpu.scenes import make

MAP = np.linspace(-1, 1, 512 * 512, dtype=np.float32).reshape(512, 512)


def lfgpu(*arguments: object) -> str:
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert done.exit_code == 0, done.stderr
    return done.stdout


def test_the_folder_of_a_submission(tmp_path: Path) -> None:
    missing = write_submission(tmp_path / "out", {"cotton": (MAP, 1.25), "dots": (MAP + 1, 3.0)})
    assert set(missing) == set(SCENES) - {"cotton", "dots"}
    names = sorted(str(file.relative_to(tmp_path / "out")) for file in (tmp_path / "out").rglob("*.*"))
    assert names == ["disp_maps/cotton.pfm", "disp_maps/dots.pfm", "runtimes/cotton.txt", "runtimes/dots.txt"]
    np.testing.assert_array_equal(read_map(tmp_path / "out" / "disp_maps" / "dots.pfm"), MAP + 1)
    assert float((tmp_path / "out" / "runtimes" / "cotton.txt").read_text()) == 1.25


@pytest.mark.parametrize(
    ("scene", "disparity", "seconds", "words"),
    [
        ("kitchen", MAP, 1.0, "'kitchen' is no scene of the benchmark"),
        ("dots", MAP[:-1], 1.0, "the map of dots is 512 x 511"),
        ("dots", np.where(MAP > 0.999, np.nan, MAP), 1.0, "undefined in "),
        ("dots", MAP, 0.0, "the runtime of dots must be a positive number"),
        ("dots", MAP, float("nan"), "the runtime of dots must be a positive number"),
    ],
)
def test_what_the_benchmark_does_not_take(
    scene: str, disparity: np.ndarray, seconds: float, words: str, tmp_path: Path
) -> None:
    with pytest.raises(LightFieldError, match=re.escape(words)):
        write_submission(tmp_path / "out", {"cotton": (MAP, 1.0), scene: (disparity, seconds)})
    assert not (tmp_path / "out").exists()


def test_a_submission_from_what_depth_wrote(tmp_path: Path) -> None:
    lf = make("boxes", grid=(1, 3), size=(512, 512))
    write_hci(lf, tmp_path / "scene")
    lfgpu("depth", tmp_path / "scene", "-o", tmp_path / "Cotton", "--preset=fast", "--disparity-range=-2,2")
    said = " ".join(lfgpu("eval", tmp_path / "Cotton", "--hci-submission", tmp_path / "sent").split())
    assert "11 are missing: backgammon, dots" in said
    stored = read_map(tmp_path / "sent" / "disp_maps" / "cotton.pfm")
    np.testing.assert_array_equal(stored, read_map(tmp_path / "Cotton" / "disparity.pfm"))
    assert float((tmp_path / "sent" / "runtimes" / "cotton.txt").read_text()) > 0
    write_pfm(tmp_path / "dots.pfm", MAP)
    refused = CliRunner().invoke(app, ["eval", str(tmp_path / "dots.pfm"), "--hci-submission", str(tmp_path / "x")])
    assert refused.exit_code == 1
    assert "does not say how long it took" in refused.stderr


def test_measures_of_regions() -> None:
    truth = np.zeros((60, 80))
    found = truth.copy()
    found[20, 30:40] = 0.2  # too near
    found[40, 30:40] = -0.2  # too far
    found[30, 30:35] = np.nan
    everywhere = np.ones(truth.shape, np.bool_)
    masks = {"discontinuities": everywhere, "fine": everywhere, "fine_surrounding": everywhere}
    scores = evaluate_regions(found, truth, masks, border=15)
    inside = (60 - 30) * (80 - 30) / 100
    assert scores["discontinuities"] == pytest.approx(25 / inside)
    assert scores["fine structures, fattening"] == pytest.approx(15 / inside)
    assert scores["fine structures, thinning"] == pytest.approx(15 / inside)
    assert "planes, bumpiness" not in scores


def test_bumpiness_is_that_of_second_derivatives() -> None:
    y, x = np.mgrid[:60, :80].astype(np.float64)
    truth = 0.3 * x - 0.2 * y
    masks = {"planes": np.ones(truth.shape, np.bool_)}
    for found, bumpy in ((truth + 0.01 * x + 5, 0.0), (truth + 0.005 * x**2, 1.0), (truth + 0.005 * x * y, 0.5**0.5)):
        assert evaluate_regions(found, truth, masks)["planes, bumpiness"] == pytest.approx(bumpy, abs=1e-9)
    assert evaluate_regions(truth + x**3, truth, masks)["planes, bumpiness"] == pytest.approx(5.0)  # at most


def test_eval_shows_the_regions_that_a_scene_has(tmp_path: Path) -> None:
    lf = make("boxes", grid=(3, 3), size=(48, 56))
    write_hci(lf, tmp_path / "scene")
    assert lf.truth is not None
    write_pfm(tmp_path / "map.pfm", lf.truth.disparity + np.float32(0.1))
    assert "discontinuities" not in lfgpu("eval", tmp_path / "map.pfm", tmp_path / "scene")
    mask = Image.fromarray(np.full((48, 56), 255, np.uint8))
    mask.save(tmp_path / "scene" / "mask_discontinuities_lowres.png")
    (tmp_path / "scene" / "evaluation_masks").mkdir()
    mask.save(tmp_path / "scene" / "evaluation_masks" / "mask_planes.png")
    assert set(read_region_masks(tmp_path / "scene")) == {"discontinuities", "planes"}
    said = lfgpu("eval", tmp_path / "map.pfm", tmp_path / "scene")
    assert re.search(r"discontinuities \(%\) +100.00", said)
    assert re.search(r"planes, bumpiness \(x100\) +0.00", said)
