"""A result as one file: everything comes back, and what is no result is refused in a sentence."""

import io
import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfgpu.data import DepthResult, DisparityMap, Geometry
from lfgpu.errors import LightFieldError
from lfgpu.io import load, read_map, save
from lfgpu.methods import PRESETS
from lfgpu.methods.synthesis.config import SynthesisConfig
from tests.made import made_result

SHAPE = (6, 7)
MAPS = ("disparity", "confidence")


def a_result(**changes: Any) -> DepthResult:
    numbers = np.random.default_rng(1).random((5, *SHAPE)).astype(np.float32)
    numbers[2, 0, 0] = np.nan
    result = made_result(
        *numbers[:2],
        stages={"local": numbers[2], "propagate": numbers[3], "refine": numbers[0]},
        position=(4.0, 3.0),
        disparity_range=(-1.25, 1.5),
        config=SynthesisConfig().with_values({"prior.window": 7, "propagation.solver": "lbfgsb"}),
        status="It stopped after 3 iterations: so it is.",
        trace=(3.0, 2.5, 0.1 + 0.2),
        timings={"local": 0.1, "total": 0.3},
        device="cuda:0",
        versions={"lfgpu": "0.1.0", "numpy": "2.0"},
        geometry=Geometry(500.0, 0.05, 4.25, (3.0, 2.5), 1.25, (1.0, 2.0)),
        name="Käse & $dollars$",
    )
    return replace(result, **changes)


@pytest.mark.parametrize(
    "geometry", [None, Geometry(500.0, 0.05, 4.25, (3.0, 2.5), 1.25, (1.0, 2.0)), Geometry(480.0, 0.1)]
)
def test_everything_comes_back(geometry: Geometry | None, tmp_path: Path) -> None:
    written = a_result(geometry=geometry)
    save(written, tmp_path / "r.npz")
    read = load(tmp_path / "r.npz")
    for name in MAPS:
        np.testing.assert_array_equal(getattr(read, name), getattr(written, name))
        assert getattr(read, name).dtype == np.float32
    assert list(read.stages) == list(written.stages)
    for name, values in written.stages.items():
        np.testing.assert_array_equal(read.stages[name], values)
    for field in fields(DepthResult):
        if field.name not in (*MAPS, "stages"):
            assert getattr(read, field.name) == getattr(written, field.name), field.name


def test_others_can_read_the_file_without_lfgpu(tmp_path: Path) -> None:
    written = a_result(geometry=Geometry(480.0, 0.1))
    save(written, tmp_path / "r.npz")
    with np.load(tmp_path / "r.npz", allow_pickle=False) as arrays:
        assert written.depth is not None
        np.testing.assert_array_equal(arrays["depth"], written.depth)
        about = json.loads(str(arrays["lfgpu"]), parse_constant=pytest.fail)  # no NaN, no Infinity: not JSON
    assert about["geometry"]["focus_distance_m"] is None
    assert about["config"]["prior"]["window"] == 7
    assert "larger is nearer" in about["convention"]
    np.testing.assert_array_equal(read_map(tmp_path / "r.npz"), written.disparity)


def test_only_results_are_taken_for_results(tmp_path: Path) -> None:
    save(a_result(), tmp_path / "r.npz")
    np.savez(tmp_path / "other.npz", disparity=np.zeros(SHAPE))
    assert isinstance(load(tmp_path / "r.npz"), DepthResult)
    assert isinstance(load(tmp_path / "other.npz"), DisparityMap)


def changed(content: bytes, change: Callable[[dict[str, Any], dict[str, Any]], None]) -> bytes:
    """The file with `change(arrays, about)` applied."""
    with np.load(io.BytesIO(content)) as loaded:
        arrays = dict(loaded)
    about = json.loads(str(arrays.pop("lfgpu")))
    change(arrays, about)
    buffer = io.BytesIO()
    np.savez(buffer, **{"lfgpu": np.array(json.dumps(about)), **arrays})
    return buffer.getvalue()


AGAIN = "copy it again, or write it anew."
DAMAGES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda _: b"", f"NumPy data: it does not begin as .npy and .npz files do; {AGAIN}"),
    "text": (lambda _: b"hello", f"NumPy data: it does not begin as .npy and .npz files do; {AGAIN}"),
    "half": (lambda whole: whole[: len(whole) // 2], f"NumPy data: it ends too early; {AGAIN}"),
    "a byte": (
        lambda whole: whole[:200] + bytes([whole[200] ^ 255]) + whole[201:],
        f"NumPy data: it is damaged .Bad CRC-32 for file 'disparity.npy'.; {AGAIN}",
    ),
    "not JSON": (lambda whole: changed(whole, lambda a, _: a.update(lfgpu=np.array("{"))), "damaged result"),
    "a list": (lambda whole: changed(whole, lambda a, _: a.update(lfgpu=np.array("[]"))), "damaged result"),
    "no status": (lambda whole: changed(whole, lambda _, about: about.pop("status")), "it has no 'status'"),
    "no map": (lambda whole: changed(whole, lambda a, _: a.pop("confidence")), "it has no 'confidence'"),
    "wrong size": (lambda whole: changed(whole, lambda a, _: a.update(stage_local=np.zeros((2, 2)))), "stage|local"),
    "wrong value": (lambda whole: changed(whole, lambda _, a: a["config"]["prior"].update(window=8)), "must be odd"),
    "large value": (lambda whole: changed(whole, lambda _, a: a["config"]["prior"].update(window=10**400)), "damaged"),
    "parameters as a list": (lambda whole: changed(whole, lambda _, a: a.update(config=[])), "damaged"),
    "later layout": (lambda whole: changed(whole, lambda _, about: about.update(layout=3)), "a later version of"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_no_result_is_refused(damage: str, tmp_path: Path) -> None:
    save(a_result(), tmp_path / "good.npz")
    bad, words = tmp_path / "bad.npz", DAMAGES[damage][1]
    bad.write_bytes(DAMAGES[damage][0]((tmp_path / "good.npz").read_bytes()))
    with pytest.raises(LightFieldError, match=words) as caught:
        load(bad)
    assert str(bad) in str(caught.value)


def test_a_result_of_version_0_2_can_be_read() -> None:
    """It has 46 parameters, of which this version keeps a few."""
    result = load(Path(__file__).parent / "files" / "result-0.2.npz")
    assert result.disparity.shape == (24, 28)
    assert -1.6 <= np.nanmin(result.disparity) < np.nanmax(result.disparity) <= 1.6
    assert result.config == PRESETS["fast"].with_values({"sweep.step": 0.3})
    assert result.versions["lfgpu"] == "0.2.0"


@pytest.mark.parametrize("name", ["accurate", "fast", "paper", "paper-exact"])
def test_parameters_that_come_and_go_make_no_file_unreadable(name: str, tmp_path: Path) -> None:
    def change(_: dict[str, Any], about: dict[str, Any]) -> None:
        about["config"]["prior"].pop("window")
        about["config"]["prior"]["breadth"] = 3
        about["config"]["later"] = {"depth": 1.0}

    save(a_result(config=PRESETS[name]), tmp_path / "r.npz")
    (tmp_path / "other.npz").write_bytes(changed((tmp_path / "r.npz").read_bytes(), change))
    assert load(tmp_path / "other.npz").config == PRESETS[name]


def test_pickles_are_not_opened(tmp_path: Path) -> None:
    np.savez(tmp_path / "bad.npz", lfgpu=np.array([print], dtype=object))
    with pytest.raises(LightFieldError, match="it holds Python objects"):
        load(tmp_path / "bad.npz")
