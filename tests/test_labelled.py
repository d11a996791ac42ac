"""Light fields and maps as xarray datasets: values, axes, coordinates and units are those of the arrays."""

import sys
from pathlib import Path

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes


@pytest.fixture(scope="module")
def lf() -> lfgpu.LightField:
    pytest.importorskip("xarray", reason="xarray is not installed: pip install 'lfgpu[xarray]'")
    return scenes.make("boxes", grid=(3, 5), size=(24, 32))


@pytest.fixture(scope="module")
def result(lf: lfgpu.LightField) -> lfgpu.DepthResult:
    return lfgpu.estimate_depth(lf, config="fast", disparity_range=(-2, 2), check_cameras=False)


def test_a_grid_has_rows_and_columns(lf: lfgpu.LightField) -> None:
    found = lfgpu.to_xarray(lf)
    assert found.views.dims == ("v", "u", "y", "x", "channel")
    index = lf.index_of(1, 4)
    picked = found.views.sel(v=1, u=4, channel="green")
    np.testing.assert_array_equal(picked, lf.views[index, ..., 1])
    np.testing.assert_allclose(picked * found.views.scale_factor_to_unit_intensity, lf.image(index)[..., 1], rtol=1e-6)
    assert (found.u.units, found.x.units) == ("view steps", "px")
    assert found.attrs["reference"] == [2.0, 1.0]
    assert found.attrs["baseline_m"] == lf.geometry.baseline_m  # type: ignore[union-attr]
    assert np.shares_memory(found.views.values, lf.views)


def test_views_that_fill_no_grid_are_a_list(lf: lfgpu.LightField) -> None:
    found = lfgpu.to_xarray(lf.subset("cross"))
    assert found.views.dims == ("view", "y", "x", "channel")
    np.testing.assert_array_equal(np.stack([found.u, found.v], 1), lf.subset("cross").positions)


def test_masks_come_too(lf: lfgpu.LightField) -> None:
    valid = np.ones(lf.views.shape[:3], bool)
    valid[0, 0, 0] = False
    found = lfgpu.to_xarray(lfgpu.LightField(lf.views, lf.positions, valid=valid))
    assert int((~found.valid).sum()) == 1


def test_a_result_has_units_and_its_file_comes_back(result: lfgpu.DepthResult, tmp_path: Path) -> None:
    import xarray

    found = lfgpu.to_xarray(result)
    assert {name: found[name].units for name in found} == {
        "disparity": "px per view step",
        "confidence": "1",
        "uncertainty": "px per view step",
        "depth": "m",
    }
    for name in found:
        np.testing.assert_array_equal(found[name], getattr(result, str(name)))
        assert found[name].dims == ("y", "x")
    assert found.attrs["position"] == [2.0, 1.0]
    found.to_netcdf(tmp_path / "map.nc", engine="scipy")
    with xarray.open_dataset(tmp_path / "map.nc", engine="scipy") as read:
        np.testing.assert_array_equal(read.disparity, result.disparity)
        assert read.attrs["convention"] == found.attrs["convention"]


def test_maps_of_all_views_and_a_map_without_geometry(result: lfgpu.DepthResult, lf: lfgpu.LightField) -> None:
    maps = np.broadcast_to(result.disparity, lf.views.shape[:3])
    all_views = lfgpu.ViewsResult(maps, maps, lf.positions, (7,), result, {})
    assert lfgpu.to_xarray(all_views).disparity.dims == ("view", "y", "x")
    assert set(lfgpu.to_xarray(lfgpu.DisparityMap(result.disparity))) == {"disparity"}


def test_what_cannot_be_converted_gets_a_sentence(lf: lfgpu.LightField, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(lfgpu.LightFieldError, match="not ndarray"):
        lfgpu.to_xarray(lf.views)  # type: ignore[arg-type]
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(lfgpu.LightFieldError, match=r"to_xarray needs xarray.*\[xarray\]"):
        lfgpu.to_xarray(lf)
