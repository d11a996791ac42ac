"""A range of disparities that excludes the scene is said so."""

from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from typer.testing import CliRunner

import lfgpu
from lfgpu import DepthPipeline, scenes
from lfgpu._backends import open_device
from lfgpu.cli import app
from lfgpu.data.lightfield import LightField
from lfgpu.errors import LightFieldError
from lfgpu.io import write_hci
from lfgpu.pipelines.verdict import judged, views_alone

WHERE = open_device("warp", "cpu")


@pytest.fixture(scope="module")
def lf() -> LightField:
    return scenes.make("boxes", grid=(3, 3), size=(96, 112))


@pytest.mark.parametrize("given", [(3.0, 5.0), (-9.0, -5.0)])
def test_a_range_without_the_scene(lf: LightField, given: tuple[float, float]) -> None:
    result = lfgpu.estimate_depth(lf, disparity_range=given, config="fast")
    assert "the map may be wrong everywhere" in result.notes[0]
    assert result.notes[0] in repr(result)
    assert result.notes[0] in result._repr_html_()


def test_a_range_with_the_scene(lf: LightField) -> None:
    assert lf.truth is not None
    low, high = float(lf.truth.disparity.min()), float(lf.truth.disparity.max())
    result = lfgpu.estimate_depth(lf, disparity_range=(-3, 3), config="fast")
    assert result.notes == ()
    for given in ((low, high), (low - 1, high + 1), (low - 20, high + 20), (low, (low + 2 * high) / 3), None):
        assert judged(lf, result, disparity_range=given).notes == ()
    assert views_alone(lf, WHERE) == ((), ())


def test_the_map_of_a_pipeline_says_so_itself(lf: LightField) -> None:
    """A pipeline does not search for another range: what it says comes from its maps."""
    pipeline = DepthPipeline(lf, config="fast", disparity_range=(0.5, 3.0))
    assert any("of the map lies at its far end" in note for note in pipeline.estimate().notes)
    pipeline.upload(noise_in_a_row(lf.views.shape, 4, 0))
    assert any("The confidence is at most 0.1 at 95 %" in note for note in pipeline.estimate().notes)
    assert DepthPipeline(lf, config="fast", disparity_range=(-3.0, 3.0)).estimate().notes == ()


def noise_in_a_row(shape: tuple[int, ...], blur: float, seed: int) -> np.ndarray:
    """Blurred, so that single pixels find something alike."""
    values = gaussian_filter(np.random.default_rng(seed).normal(size=shape), (0, blur, blur, 0))
    return np.clip(128 + 40 * values / values.std(), 0, 255).astype(np.uint8)


def test_blurred_noise_is_refused_or_not_believed() -> None:
    """Where it is very smooth, the range finder takes a few pixels of it for evidence."""
    positions = np.stack([np.arange(5.0), np.zeros(5)], axis=1)
    refused, results = [], []
    for blur in (2, 4, 6):
        for seed in range(4):
            row = noise_in_a_row((5, 64, 64, 3), blur, seed)
            try:
                results.append(lfgpu.estimate_depth(LightField(row, positions), config="fast"))
            except LightFieldError as error:
                refused.append(str(error))
    assert refused
    assert all("the disparity range cannot be found" in message for message in refused)
    assert results
    for result in results:
        assert any("The confidence is at most 0.1 at 95 %" in note for note in result.notes)


def test_blurred_noise_is_not_believed_without_a_look_at_the_cameras() -> None:
    positions = np.stack([np.arange(5.0), np.zeros(5)], axis=1)
    for seed in (2, 3):  # those in which a range is found
        row = LightField(noise_in_a_row((5, 64, 64, 3), 6, seed), positions)
        result = lfgpu.estimate_depth(row, config="fast", check_cameras=False)
        assert any("The confidence is at most 0.1 at 95 %" in note for note in result.notes)


def test_the_command_says_so(lf: LightField, tmp_path: Path) -> None:
    write_hci(lf, tmp_path / "in")
    command = ["depth", str(tmp_path / "in"), "-o", str(tmp_path / "out"), "--preset=fast", "--disparity-range=3,5"]
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert "the map may be wrong everywhere" in " ".join(done.stdout.split())


NOISE = {
    "grey": ((3, 3, 64, 72, 1), 1.0),
    "colour": ((5, 5, 64, 72, 3), 1.0),
    "of a sensor in the dark": ((5, 5, 64, 72, 3), 0.02),
    "in a row": ((1, 9, 64, 72, 3), 1.0),
    "two": ((1, 2, 64, 72, 3), 1.0),
}


def noise(kind: str) -> LightField:
    """Views that have nothing to do with each other."""
    shape, contrast = NOISE[kind]
    values = 0.5 + contrast * (np.random.default_rng(len(kind)).random(shape) - 0.5)
    return LightField.from_grid(np.rint(255 * values).astype(np.uint8))


@pytest.mark.parametrize("kind", NOISE)
def test_noise_is_said_to_be_nothing_and_is_not_believed(kind: str, tmp_path: Path) -> None:
    views = noise(kind)
    notes, remarks = views_alone(views, WHERE)
    assert "Nowhere do the views look alike" in notes[0]
    assert remarks == ()
    with pytest.raises(LightFieldError, match="nowhere do views look alike"):
        lfgpu.estimate_depth(views)
    result = lfgpu.estimate_depth(views, disparity_range=(-2, 2))
    assert "The map means nothing" in result.notes[0]
    assert result.confidence.max() <= 0.1
    assert result.uncertainty is not None
    assert result.uncertainty.min() >= 1.15  # as uncertain as a number that may be anything from -2 to 2
    result.save(tmp_path / "result.npz")
    assert lfgpu.load(tmp_path / "result.npz").notes == result.notes


def test_all_views_and_tiles_of_noise_are_not_believed_either() -> None:
    views = noise("grey")
    assert lfgpu.estimate_all_views(views, disparity_range=(-2, 2), config="fast").confidences.max() < 0.101
    tiled = lfgpu.estimate_depth(views, disparity_range=(-2, 2), config="fast", max_memory="1GiB")
    assert tiled.confidence.max() < 0.101


def test_commands_say_that_noise_is_nothing(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", noise("grey").views.reshape(3, 3, 64, 72, 1))
    command = ["depth", str(tmp_path / "a.npy"), "-o", str(tmp_path / "out"), "--preset=fast", "--disparity-range=-2,2"]
    for done in (CliRunner().invoke(app, ["info", str(tmp_path / "a.npy")]), CliRunner().invoke(app, command)):
        assert done.exit_code == 0, done.output
        assert "they are noise, have no texture" in " ".join(done.stdout.split())
