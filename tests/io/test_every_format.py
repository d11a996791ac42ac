"""One scene in every format: the same views, in their places, moving the way they should; and depth from each."""

import re
from pathlib import Path

import numpy as np
import pytest
from fields import SAMPLES
from samples import refusal
from typer.testing import CliRunner

from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.io import FORMATS, read, recognise
from lfgpu.io.parallax import axes_agree, runs_as_truth

DOCS = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def written(true: LightField, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {name: sample.write(true, tmp_path_factory.mktemp(name)) for name, sample in SAMPLES.items()}


def test_every_format_has_a_sample_and_stands_in_the_docs() -> None:
    raw = {"lenslet"}  # holds no views but what they are made of: lenslet_samples.py has its samples
    assert {sample.format for sample in SAMPLES.values()} == {entry.name for entry in FORMATS} - raw
    for entry in FORMATS:
        assert f"| `{entry.name}` |" in DOCS


@pytest.mark.parametrize("name", SAMPLES)
def test_recognised(name: str, written: dict[str, Path]) -> None:
    entry, reason = recognise(written[name])
    assert entry.name == SAMPLES[name].format
    assert reason


@pytest.mark.parametrize("name", SAMPLES)
def test_the_same_light_field_comes_back(name: str, written: dict[str, Path], true: LightField) -> None:
    sample = SAMPLES[name]
    found = read(written[name], **sample.options)
    expected = true.subset(sample.views)
    assert len(found.views) == len(expected.views) - (name == "lftoolbox-7.3")  # without its dark corner
    assert found.size == true.size
    np.testing.assert_allclose(found.offsets[found.reference_index], 0)
    for index, (du, dv) in enumerate(found.offsets):
        u, v = expected.positions[expected.reference_index] + (du, dv)
        wanted = expected.image(expected.index_of(round(v, 5), round(u, 5)))
        np.testing.assert_allclose(found.image(index), wanted, atol=1e-6 if sample.exact else 0.12)
        if not sample.exact:
            assert np.mean(np.abs(found.image(index) - wanted)) < 0.02


@pytest.mark.parametrize("name", [name for name, sample in SAMPLES.items() if sample.views == "full"])
def test_both_axes_run_alike(name: str, written: dict[str, Path]) -> None:
    assert axes_agree(read(written[name], **SAMPLES[name].options)) is True


@pytest.mark.parametrize("name", [name for name, sample in SAMPLES.items() if sample.truth])
def test_truth_comes_back_and_views_move_as_it_says(name: str, written: dict[str, Path], true: LightField) -> None:
    found = read(written[name])
    truth = found.reference_truth()
    assert truth is not None
    assert true.truth is not None
    np.testing.assert_allclose(truth.disparity, true.truth.disparity, atol=1e-5)
    assert runs_as_truth(found, 0) is True
    assert runs_as_truth(found, 1) is True
    assert found.geometry is not None
    inside = found.geometry.depth(truth.disparity)
    np.testing.assert_allclose(found.geometry.disparity(inside), truth.disparity, atol=1e-4)


@pytest.mark.parametrize("name", SAMPLES)
def test_depth_and_info_of_each(name: str, written: dict[str, Path], tmp_path: Path) -> None:
    told = [f"--{key}={'x'.join(map(str, value))}" for key, value in SAMPLES[name].options.items()]
    shown = CliRunner().invoke(app, ["info", str(written[name]), *told])
    assert shown.exit_code == 0, shown.stderr
    assert re.search(rf"format +{SAMPLES[name].format}, because", shown.stdout)
    out = tmp_path / "out"
    arguments = ["depth", str(written[name]), "-o", str(out), "--preset=fast", "--disparity-range=-2,2", *told]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.stderr
    assert (out / "disparity.pfm").is_file()


@pytest.mark.parametrize("name", SAMPLES)
def test_written_descriptions_read_back(name: str, written: dict[str, Path], tmp_path: Path) -> None:
    told = [f"--{key}={'x'.join(map(str, value))}" for key, value in SAMPLES[name].options.items()]
    file = tmp_path / "deep" / "array.toml"
    done = CliRunner().invoke(app, ["info", str(written[name]), "--write", str(file), *told])
    assert done.exit_code == 0, done.stderr
    first, again = read(written[name], **SAMPLES[name].options), read(file)
    np.testing.assert_array_equal(again.views, first.views)
    np.testing.assert_array_equal(again.positions, first.positions)
    assert (again.reference, again.grid_shape, again.geometry, again.name) == (
        first.reference,
        first.grid_shape,
        first.geometry,
        first.name,
    )
    if first.truth is not None:
        assert again.truth is not None
        np.testing.assert_array_equal(again.truth.disparity, first.truth.disparity)
        assert again.truth.position == first.truth.position
    if first.valid is not None and not first.files:
        np.testing.assert_array_equal(again.valid, first.valid)


EXTRAS = {
    "blender": "OpenEXR",
    "hci-hdf5": "h5py",
    "lftoolbox-7.3": "h5py",
    "tiff-stack": "tifffile",
    "video": "imageio_ffmpeg",
    "lytro": "imageio_ffmpeg",
}


@pytest.mark.parametrize("name", EXTRAS)
def test_a_missing_library_is_named_with_its_extra(
    name: str, written: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, EXTRAS[name], None)
    extra = next(entry.extra for entry in FORMATS if entry.name == SAMPLES[name].format)
    text = refusal(lambda: read(written[name]))
    assert f"pip install -e '.[{extra}]'" in text
    assert str(written[name]) in text
