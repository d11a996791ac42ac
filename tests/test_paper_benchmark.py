"""`python -m benchmarks paper`: what is measured of a light field that is there, what is said of one that is not."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmarks import paper, results
from benchmarks.cli import app
from benchmarks.clock import spread
from benchmarks.results import Record, Run
from lfgpu import estimate_depth, evaluate
from tests import printed
from tests.io.fields import SAMPLES, scene

pytestmark = pytest.mark.thorough


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with one scene of the old HCI set; the equations are not what is tested."""
    monkeypatch.setattr(printed, "errors", lambda *_: {"an equation": 1e-7})
    folder = tmp_path / "data" / "buddha"
    folder.mkdir(parents=True)
    SAMPLES["hci-hdf5"].write(scene(), folder)
    return folder.parent


def test_a_scene_that_is_there_is_measured_and_the_others_are_skipped_with_a_word(data: Path, tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    arguments = ["--data", str(data), "--out", str(tmp_path / "paper.json"), "--presets", "fast"]
    names = "buddha-9x9x768x768,horses-9x9x768x768"
    outcome = CliRunner().invoke(app, ["paper", "--experiments", names, *arguments])
    assert outcome.exit_code == 0, outcome.output
    assert f"horses-9x9x768x768: skipped: {data / 'horses'} does not exist" in outcome.stderr.replace("\n", "")
    found = [r for r in results.load(tmp_path / "paper.json").records if r.kind == paper.KIND]
    assert [(r.case, r.name, r.failed) for r in found] == [("buddha-9x9x768x768", "fast", "")]
    lf = scene()
    assert lf.truth is not None
    want = evaluate(estimate_depth(lf, config="fast").disparity, lf.truth.disparity).rmse
    assert found[0].errors["rmse boundaries"] == pytest.approx(want, rel=1e-3)
    assert "mean of" not in outcome.stdout


def test_the_mean_of_the_old_hci_set_is_that_of_last_stages() -> None:
    records = [
        Record(paper.KIND, "warp", "cpu", e.name, "paper", spread([1.0]), errors={"rmse local": 9, "rmse refine": n})
        for n, e in enumerate(e for e in paper.EXPERIMENTS if e.name.endswith("-9x9x768x768"))
    ]
    run = Run("", {}, {}, "", 1, 0.0, records, [])
    assert paper.experiments(run).rows[-1] == ("mean of the old HCI set", "`paper`", "–", "–", "3.000", "–")
    assert "mean" not in paper.experiments(Run("", {}, {}, "", 1, 0.0, records[1:], [])).rows[-1][0]


def test_specks_are_counted() -> None:
    plane = np.add.outer(np.arange(20.0), np.arange(25.0)) / 100
    assert paper.speckle(plane) == 0
    plane[10, 10] += 0.2
    plane[3, 3] = np.nan
    assert paper.speckle(plane) == pytest.approx(100 / 499)
