"""Unknown is NaN: masked pixels in maps, stages, tiles, streams, files and on the command line; and filling them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import lfgpu
from lfgpu import LightField, scenes
from lfgpu.cli import app
from lfgpu.data.filling import filled
from lfgpu.data.points import point_cloud
from lfgpu.errors import LightFieldError
from lfgpu.viz.colours import painted

RANGE = (-1.6, 1.7)
HOLE = np.s_[:10, -16:]


def masked(size: tuple[int, int] = (40, 48)) -> LightField:
    """A scene of which no view recorded one corner."""
    lf = scenes.make("relief", grid=(5, 5), size=size)
    valid = np.ones(lf.views.shape[:3], bool)
    valid[(slice(None), *HOLE)] = False
    return replace(lf, valid=valid)


def hole(lf: LightField) -> np.ndarray:
    assert lf.valid is not None
    return ~lf.valid[lf.reference_index]


@pytest.mark.parametrize("config", ["accurate", "fast", "paper"])
def test_masked_pixels_of_the_reference_are_nan_in_all_maps(config: str, target: Any) -> None:
    lf = masked()
    result = lfgpu.estimate_depth(
        lf, config=config, disparity_range=RANGE, backend=target.backend, device=target.device
    )
    np.testing.assert_array_equal(np.isnan(result.disparity), hole(lf))
    assert (result.confidence[hole(lf)] == 0).all()
    assert (result.confidence[~hole(lf)] > 0).any()
    for name, map_ in result.stages.items():
        assert np.isnan(map_[hole(lf)]).all(), name


def test_they_leave_the_rest_as_it_is(target: Any) -> None:
    lf = masked()
    pipeline = lfgpu.DepthPipeline(
        lf, config="fast", disparity_range=RANGE, backend=target.backend, device=target.device
    )
    maps = []
    for _ in range(3):  # the next run does not start from what the last one left
        pipeline.run()
        maps.append(pipeline.disparity())
    np.testing.assert_array_equal(maps[0], maps[2])
    whole = lfgpu.estimate_depth(replace(lf, valid=None), config="fast", disparity_range=RANGE, device="cpu")
    assert np.nanquantile(np.abs(maps[0] - whole.disparity), 0.95) < 0.01


def test_tiles_have_the_same_holes() -> None:
    lf = masked((150, 220))
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu", max_memory="1GiB")
    np.testing.assert_array_equal(np.isnan(result.disparity), hole(lf))
    assert (result.confidence[hole(lf)] == 0).all()


def test_streams_have_the_same_holes_in_every_frame() -> None:
    lf = masked()
    with lfgpu.DepthStream(lf, config="fast", disparity_range=RANGE, device="cpu") as stream:
        for _ in range(3):
            np.testing.assert_array_equal(np.isnan(stream.push(lf.views).numpy()), hole(lf))


def test_maps_of_all_views_are_nan_where_no_key_view_shows_the_pixel() -> None:
    lf = masked()
    result = lfgpu.estimate_all_views(lf, keys=1, config="fast", disparity_range=RANGE)
    known = np.isfinite(result.disparities)
    assert not known[lf.reference_index][hole(lf)].any()
    assert known[lf.reference_index][~hole(lf)].all()
    assert (result.confidences[~known] == 0).all()


@pytest.mark.parametrize("suffix", ["npz", "pfm", "tif", "exr", "png"])
def test_files_keep_them(tmp_path: Path, suffix: str) -> None:
    if suffix == "exr":
        pytest.importorskip("OpenEXR")
    lf = masked()
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu")
    result.save(tmp_path / f"map.{suffix}")
    loaded = lfgpu.load(tmp_path / f"map.{suffix}")
    np.testing.assert_array_equal(np.isnan(loaded.disparity), hole(lf))
    np.testing.assert_allclose(loaded.disparity, result.disparity, atol=1e-4)  # NaN are equal
    if suffix == "png":  # whose scale is that of the known values
        assert np.nanmin(loaded.disparity) == pytest.approx(np.nanmin(result.disparity), abs=1e-6)


def test_they_have_no_point_and_are_grey() -> None:
    lf = masked()
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu")
    assert len(point_cloud(result).points) == (~hole(lf)).sum()
    pictured = painted(result.disparity, "viridis", RANGE)
    assert len(np.unique(pictured[hole(lf)], axis=0)) == 1
    assert np.ptp(pictured[hole(lf)][0].astype(int)) < 10


def test_filling_takes_the_farther_side_and_says_so() -> None:
    nan = np.nan
    np.testing.assert_array_equal(lfgpu.fill_unknown([[2.0, nan, nan, -1.0, nan]]), [[2, -1, -1, -1, -1]])
    np.testing.assert_array_equal(lfgpu.fill_unknown([[[nan, 1.0]], [[3.0, nan]]]), [[[1, 1]], [[3, 3]]])
    lf = masked()
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu")
    whole = filled(result)
    assert np.isfinite(whole.disparity).all()
    np.testing.assert_array_equal(whole.disparity[~hole(lf)], result.disparity[~hole(lf)])
    assert "8.3 % of the pixels are not known; they were filled" in whole.status
    assert filled(whole) is whole
    with pytest.raises(LightFieldError, match="no known value"):
        lfgpu.fill_unknown([[nan]])
    with pytest.raises(LightFieldError, match=r"must be \[y, x\]"):
        lfgpu.fill_unknown([1.0])


def test_the_command_line_says_how_much_is_unknown_and_fills_it(tmp_path: Path) -> None:
    lf = masked()
    np.savez(tmp_path / "lf.npz", views=lf.views, positions=lf.positions, valid=lf.valid)

    def told(out: str, *options: str) -> str:
        arguments = ["depth", str(tmp_path / "lf.npz"), "-o", str(tmp_path / out), "--preset", "fast", *options]
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0, done.output
        return " ".join(done.output.split())

    said = told("holes")
    assert "8.3 % of the pixels (NaN): masked in this view; --fill fills them" in said
    assert "nan to" not in said
    assert np.isnan(lfgpu.load(tmp_path / "holes" / "disparity.pfm").disparity).sum() == hole(lf).sum()
    said = told("whole", "--fill")
    assert "8.3 % of the pixels are not known; they were filled" in said
    assert np.isfinite(lfgpu.load(tmp_path / "whole" / "disparity.pfm").disparity).all()
    assert np.isfinite(lfgpu.load(tmp_path / "whole" / "result.npz").disparity).all()
