"""A range of disparities that excludes the scene is said so."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.io import write_hci
from lfgpu.methods.range_check import range_remark


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(96, 112))


@pytest.mark.parametrize("given", [(3.0, 5.0), (-9.0, -5.0)])
def test_a_range_without_the_scene(lf: LightField, given: tuple[float, float]) -> None:
    assert "the map may be wrong everywhere" in (range_remark(lf, given) or "")


def test_a_range_with_the_scene(lf: LightField) -> None:
    assert lf.truth is not None
    low, high = float(lf.truth.disparity.min()), float(lf.truth.disparity.max())
    for given in ((low, high), (low - 1, high + 1), (low - 20, high + 20), (low, (low + 2 * high) / 3)):
        assert range_remark(lf, given) is None


def test_the_command_says_so(lf: LightField, tmp_path: Path) -> None:
    write_hci(lf, tmp_path / "in")
    command = ["depth", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--preset=fast", "--disparity-range=3,5"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "the map may be wrong everywhere" in " ".join(done.stdout.split())
