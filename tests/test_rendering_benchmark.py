"""The benchmark of rendering: which views it leaves out, and what it says about them."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import rendering
from benchmarks.errors import BenchmarkError
from lfgpu import scenes
from lfgpu.io import write_hci

pytestmark = pytest.mark.thorough


def test_every_second_row_and_column_is_left_out() -> None:
    lf = scenes.make("relief", grid=(5, 5), size=(32, 32))
    kept, left_out = rendering.split(lf)
    assert kept.positions.tolist() == [[u, v] for v in (0, 2, 4) for u in (0, 2, 4)]
    assert sorted([*left_out, *(int(v) * 5 + int(u) for u, v in kept.positions)]) == list(range(25))


def test_psnr_by_hand() -> None:
    assert rendering.psnr(np.full((2, 2), 0.6, np.float32), np.full((2, 2), 0.5, np.float32)) == pytest.approx(20)


def test_rendered_views_win_on_a_scene_and_the_table_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_hci(scenes.make("relief", grid=(5, 5), size=(48, 48)), tmp_path / "relief")
    rows = list(rendering.run(["relief", "nothing"], tmp_path, preset="fast", every=6))
    assert "nothing is not there, left out" in capsys.readouterr().err
    (row,) = rows
    assert (row.scene, row.kept, row.rendered) == ("relief", 9, 3)
    for values in (row.whole, row.inner):
        assert values["rendered"] > values["mean of neighbours"] > values["nearest view"]
    assert f"**{row.whole['rendered']:.1f} / {row.inner['rendered']:.1f}**" in rendering.table(rows).markdown
    with pytest.raises(BenchmarkError, match="LFGPU_DATA"):
        list(rendering.run(["nothing"], tmp_path, preset="fast", every=1))
