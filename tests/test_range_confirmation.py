"""Ranges of disparities that exclude the scene are said so; ranges that were found are widened where surfaces end."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import lfgpu
from lfgpu import DepthPipeline, DepthStream, estimate_depth, export_pipeline, scenes
from lfgpu._backends import open_device
from lfgpu.data import LightField
from lfgpu.errors import LightFieldError
from lfgpu.methods.disparity_range import find_disparity_range
from lfgpu.pipelines.range_confirmation import confirm
from lfgpu.pipelines.verdict import judged, views_alone
from tests.made import thorough

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
    low, high = float(lf.truth.disparity.min()), float(lf.truth.disparity.max())
    result = lfgpu.estimate_depth(lf, disparity_range=(-3, 3), config="fast")
    assert result.notes == ()
    for given in ((low, high), (low - 1, high + 1), (low - 20, high + 20), (low, (low + 2 * high) / 3), None):
        assert judged(lf, result, disparity_range=given).notes == ()
    assert views_alone(lf, WHERE) == ((), ())
    ramp = np.broadcast_to(np.linspace(0, 255, 90).astype(np.uint8), (3, 3, 72, 90))  # a look says its views are off
    assert views_alone(LightField.from_grid(ramp), WHERE) == ((), ())


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


@pytest.mark.parametrize("seeds", [range(2), thorough(range(2, 4))])
def test_blurred_noise_is_refused_or_not_believed(seeds: range) -> None:
    """Where it is very smooth, the range finder takes a few pixels of it for evidence."""
    positions = np.stack([np.arange(5.0), np.zeros(5)], axis=1)
    refused, results = [], []
    for blur in (2, 4, 6):
        for seed in seeds:
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


NOISE = {
    "grey": ((3, 3, 64, 72, 1), 1.0),
    "of a sensor in the dark": ((5, 5, 64, 72, 3), 0.02),
    "in a row": ((1, 9, 64, 72, 3), 1.0),
    "two": ((1, 2, 64, 72, 3), 1.0),
}


def noise(kind: str) -> LightField:
    """Views that have nothing to do with each other."""
    shape, contrast = NOISE[kind]
    values = 0.5 + contrast * (np.random.default_rng(len(kind)).random(shape) - 0.5)
    return LightField.from_grid(np.rint(255 * values).astype(np.uint8))


@pytest.mark.parametrize("kind", ["grey", "two", *map(thorough, ("of a sensor in the dark", "in a row"))])
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
    assert result.uncertainty.min() >= 1.15  # as uncertain as a number that may be anything from -2 to 2
    result.save(tmp_path / "result.npz")
    assert lfgpu.load(tmp_path / "result.npz").notes == result.notes


def left_out(seed: int) -> LightField:
    """What is near has no texture but its outlines, in noise: the range that is found leaves over 10 % of it out."""
    options = {"size": (160, 200), "disparity_range": (-2.274, 0.726), "noise": 0.02, "reference": (5, 0)}
    lf = scenes.make("textureless", seed=seed, grid=(9, 1), channels=1, **options)  # type: ignore[arg-type]
    assert (lf.truth.disparity > find_disparity_range(lf, WHERE)[1]).mean() > 0.1
    return lf


@pytest.fixture(scope="module")
def beyond() -> LightField:
    return left_out(8924)


def test_where_wider_ranges_leave_it_open_estimates_and_streams_say_so(caplog: pytest.LogCaptureFixture) -> None:
    """In the wider range a few noisy pixels lie at its end by chance."""
    lf = left_out(8982)
    found = find_disparity_range(lf, WHERE)
    result = estimate_depth(lf, config="fast", device="cpu", check_cameras=False)
    assert result.disparity_range == found
    (note,) = (note for note in result.notes if "Surfaces may lie beyond the disparity range" in note)
    with DepthStream(lf, config="fast", device="cpu") as stream:
        assert stream.bounds == found
        assert note in stream.warnings
    assert caplog.messages.count(note) == 1


@pytest.mark.parametrize(("preset", "max_memory"), [("fast", None), ("accurate", "580MB")])
def test_it_is_widened_where_surfaces_lie_at_its_ends(beyond: LightField, preset: str, max_memory: str | None) -> None:
    """Also of an estimate in tiles."""
    seen: list[str] = []
    result = estimate_depth(
        beyond,
        config=preset,  # type: ignore[arg-type]
        device="cpu",
        max_memory=max_memory,
        check_cameras=False,
        on_progress=lambda stage, iteration, value: seen.append(stage),
    )
    low, high = result.disparity_range
    assert ((beyond.truth.disparity >= low) & (beyond.truth.disparity <= high)).all()
    assert high - low < 1.5 * np.ptp(beyond.truth.disparity)
    assert ("tiles" in seen) == (max_memory is not None)
    assert result.notes == ()


def test_a_given_range_is_kept(beyond: LightField) -> None:
    given = find_disparity_range(beyond, WHERE)
    assert estimate_depth(beyond, config="fast", device="cpu", disparity_range=given).disparity_range == given
    pipeline = DepthPipeline(beyond, config="fast", device="cpu", disparity_range=given)
    assert pipeline.estimate().disparity_range == given


def test_a_pipeline_widens_it_once(beyond: LightField) -> None:
    """At the first estimate, or before; what comes later changes nothing that was allocated."""
    pipeline = DepthPipeline(beyond, config="fast", device="cpu")
    found = pipeline.bounds
    first = pipeline.estimate()
    before = DepthPipeline(beyond, config="fast", device="cpu")
    assert before.confirm_range() == ()
    assert before.bounds == first.disparity_range
    before.run()
    assert np.array_equal(before.disparity(), first.disparity)
    late = DepthPipeline(beyond, config="fast", device="cpu")
    late.run()
    late.confirm_range()
    assert late.bounds == found
    assert pipeline.bounds == first.disparity_range != found
    pipeline.upload(beyond.views)
    pipeline.run()
    assert np.array_equal(pipeline.disparity(), first.disparity)
    pipeline.upload(np.roll(beyond.views, 1, axis=0))
    assert pipeline.estimate().disparity_range == first.disparity_range


def test_an_estimate_that_is_interrupted_changes_nothing() -> None:
    """Wherever it is: before a wider range is tried, while it is, and after it was refused."""
    lf = scenes.make("planes", grid=(3, 3), size=(64, 64), disparity_range=(-2, 2), seed=0, noise=0.1)
    calls: list[str] = []
    expected = DepthPipeline(lf, config="fast", device="cpu").estimate(on_progress=lambda *of: calls.append(of[0]))
    assert calls.count("sweep") >= 3  # the found range, a wider one, the found one again
    assert len(expected.notes) == 1
    for last in sorted({0, len(calls) - 1, *(n for n, stage in enumerate(calls) if stage == "sweep")}):
        pipeline, left = DepthPipeline(lf, config="fast", device="cpu"), [last]

        def interrupt(*_: object, left: list[int] = left) -> None:
            left[0] -= 1
            if left[0] < 0:
                raise KeyboardInterrupt

        for _ in range(2):
            left[0] = last
            with pytest.raises(KeyboardInterrupt):
                pipeline.estimate(on_progress=interrupt)
            with pytest.raises(LightFieldError, match=r"call run\(\) or estimate\(\) first"):
                pipeline.disparity()
        again = pipeline.estimate()
        assert (again.disparity_range, again.notes) == (expected.disparity_range, expected.notes)
        assert np.array_equal(again.disparity, expected.disparity)
        assert again.timings.keys() == expected.timings.keys()


def test_what_lasts_for_many_frames_has_the_wider_range(beyond: LightField, tmp_path: Path) -> None:
    """Streams and exported pipelines measure once, on the first frame."""
    expected = estimate_depth(beyond, config="fast", device="cpu", check_cameras=False).disparity_range
    with DepthStream(beyond, config="fast", device="cpu") as stream:
        assert stream.bounds == expected
    export_pipeline(beyond, tmp_path / "exported", config="fast", device="cpu")
    described = json.loads((tmp_path / "exported" / "pipeline.json").read_text())
    assert tuple(described["disparity_range"]) == expected


def confirmed(
    lf: LightField, found: tuple[float, float], *disparities: float, sure: bool = True
) -> list[tuple[float, float]]:
    """The ranges in which is matched, of surfaces that are as large as each other; they are clamped to the range."""
    tried = []

    def match(bounds: tuple[float, float]) -> np.ndarray:
        tried.append(bounds)
        return np.clip(np.asarray([disparities], np.float32), *bounds)

    doubt = confirm(lf.layout, found, match(found), match)
    assert (doubt is None) == sure
    if doubt is not None:
        assert f"from {found[0]:g} to {found[1]:g} px per view step" in doubt
    return tried[1:]


def test_the_end_at_which_surfaces_lie_is_moved() -> None:
    lf = scenes.make("relief", grid=(3, 3), size=(64, 64))
    assert confirmed(lf, (-1.0, 1.0), 0.0, 1.5) == [(-1.0, 2.0)]
    assert confirmed(lf, (-1.0, 1.0), -3.0, 0.5) == [(-2.0, 1.0), (-3.5, 1.0)]
    assert confirmed(lf, (-1.0, 1.0), -1.5, 1.5) == [(-2.0, 2.0)]
    # A sentence says so; further out than 25.6 px nothing is searched.
    ends = [(-1.0, 2.0), (-1.0, 3.5), (-1.0, 5.75), (-1.0, 1.0)]
    assert confirmed(lf, (-1.0, 1.0), 0.0, 99.0, sure=False) == ends
    assert confirmed(lf, (-9.0, 9.0), 0.0, 99.0, sure=False) == [(-9.0, 18.0), (-9.0, 9.0)]
    assert confirmed(lf, (-20.0, 20.0), 0.0, 99.0, sure=False) == []
    assert confirmed(lf, (-1.0, 1.0), -0.9, 0.0, 0.9) == []
    assert confirmed(lf, (-1.0, 1.0), np.nan, 0.9) == []
    assert confirmed(lf, (-1.0, 1.0), np.nan) == []
    # As those of noise are: a few per cent lie near the ends by chance.
    assert confirmed(lf, (-1.0, 1.0), *np.linspace(-1.0, 1.0, 1000)) == []
