"""The learned network: its backends against each other and, where PyTorch is, against PyTorch; its files."""

import json
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu, refused

from benchmarks.network import random_weights
from lfgpu import DepthPipeline, DepthResult, DepthStream, LightField, _backends, estimate_depth, evaluate, load, scenes
from lfgpu.contract import FOLD, Device
from lfgpu.data import ViewLayout
from lfgpu.errors import LightFieldError
from lfgpu.io import write_hci
from lfgpu.methods import PRESETS, configured, method_of
from lfgpu.methods.arena import Arena
from lfgpu.methods.dry_run import DryArray, DryKernels
from lfgpu.methods.matching import aggregation, unet
from lfgpu.methods.matching.alignment import Alignment
from lfgpu.methods.matching.choice import Choice
from lfgpu.methods.matching.config import MatchingConfig
from lfgpu.methods.matching.learned import BUILT_IN, NETWORK_REACH, VERSION, Network, read_weights
from lfgpu.methods.matching.unet import Weights
from lfgpu.methods.measured import Measured
from lfgpu.pipelines.all_views import estimate_all_views
from lfgpu.pipelines.export import export_pipeline
from lfgpu.pipelines.resident import KEPT
from tests.made import masked, thorough

WIDTHS = 8, 16, 8, 24
SIZE, COUNT, STEP = (45, 37), 12, 0.25
MAPS = "disparity", "probability", "deviation"


def some_views(rng: np.random.Generator, channels: int = 3) -> tuple[ViewLayout, np.ndarray]:
    offsets = np.array([(u, v) for v in (-1, 0, 1) for u in (-1, 0, 1)], np.float64)
    layout = ViewLayout(offsets, 4, SIZE, channels, np.dtype(np.uint8), 1 / 255)
    blurred = rng.random((9, *SIZE, channels)).cumsum(2)
    return layout, np.rint(255 * (blurred / blurred.max())).astype(np.uint8)


def maps(
    backend: str, weights: Weights, layout: ViewLayout, views: np.ndarray, first: np.ndarray, stored: type = np.float32
) -> list[np.ndarray]:
    kernels = _backends.load(backend)
    device = Device(kernels, "cpu")
    network = Network(Arena(device), weights, layout, COUNT, stored=stored)
    outputs = [device.zeros(SIZE) for _ in MAPS]
    for _ in range(2):  # the second call finds what the first one left in the buffers
        network.load(device.image(views), None if layout.masks is None else device.field(np.stack(layout.masks)))
        network(device.field(first), step=STEP, **{f"{name}_out": out for name, out in zip(MAPS, outputs, strict=True)})
    return [kernels.numpy(output) for output in outputs]


@pytest.mark.parametrize("backend", ["warp", thorough("taichi")])
@pytest.mark.parametrize(("stored", "within", "channels"), [(np.float32, 1e-3, 3), (np.float16, 2e-2, 1)])
def test_backends_give_the_maps_of_the_reference(
    backend: str, stored: type, within: float, channels: int, rng: np.random.Generator
) -> None:
    """Of views in colour, and of grey ones with masks in half precision, which random weights make coarse."""
    pytest.importorskip(backend)
    weights, (layout, views) = random_weights(rng, WIDTHS), some_views(rng, channels)
    if channels == 1:
        layout = replace(layout, masks=tuple(rng.random((9, *SIZE)) < 0.9))
    first = np.round(rng.uniform(-2.2, -1.8, SIZE) * 64).astype(np.float32) / 64
    want = maps("reference", weights, layout, views, first)
    got = maps(backend, weights, layout, views, first, stored)
    assert np.ptp(want[0] - first) > 1
    for name, one, other in zip(MAPS, got, want, strict=True):
        near = np.abs(one - other) <= within
        assert near.mean() >= 0.95, (name, near.mean(), np.abs(one - other).max())


@pytest.mark.parametrize("stored", [thorough(np.float32), np.float16])
def test_rows_at_a_time_give_the_bits_of_whole_volumes(
    stored: type, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    weights, (layout, views) = random_weights(rng, WIDTHS), some_views(rng)
    first, found = np.full(SIZE, -2.0, np.float32), []
    for strip in (1, 3, SIZE[0]):
        monkeypatch.setattr(unet, "_STRIP", strip)
        found.append(maps("warp", weights, layout, views, first, stored))
    for few in found[:2]:
        np.testing.assert_array_equal(few, found[2])


def test_maps_are_those_of_pytorch(rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install lfgpu[train]")
    from lfgpu.training import network as trained
    from lfgpu.training.sectors import order_of_sectors
    from lfgpu.training.weights import fold

    torch.manual_seed(int(rng.integers(2**31)))
    network = trained.Network(WIDTHS).eval()
    with torch.no_grad():
        for name, values in network.state_dict().items():
            if name.endswith("running_var") or ("norm" in name and name.endswith("weight")):
                values.uniform_(0.5, 2.0)
            elif name.endswith(("running_mean", "bias")):
                values.uniform_(-0.2, 0.2)
        network.logits.weight *= 30
    layout, views = some_views(rng)
    rows, columns = 64, 64  # multiples of 32
    more = ((0, 0), (0, rows - SIZE[0]), (0, columns - SIZE[1]), (0, 0))
    offsets = np.delete(layout.offsets, layout.reference, 0)
    order, starts = order_of_sectors(offsets)
    floats = torch.tensor(views / 255.0, dtype=torch.float32)
    reference = floats[layout.reference][None]
    others = floats[[n for n in range(9) if n != layout.reference]][order][None]
    scale = trained.brightness(reference)
    from lfgpu.training.sectors import sector_costs

    first, steps = torch.full((1, *SIZE), -2.0), torch.tensor([STEP])
    costs = sector_costs(
        others * scale, reference * scale, offsets[order], starts, margin=0, first=first, steps=steps, count=COUNT
    )
    padded = np.pad(costs.numpy()[0].transpose(1, 2, 3, 0), more, mode="edge").transpose(3, 0, 1, 2)[None]
    image = np.pad((reference * scale).numpy(), more, mode="edge").transpose(0, 3, 1, 2)
    with torch.no_grad():
        logits = network(torch.tensor(padded), torch.tensor(image))[..., : SIZE[0], : SIZE[1]]
    want = trained.peak(logits, first, steps)[0].numpy()
    got = maps("warp", fold(network.state_dict()), layout, views, np.full(SIZE, -2.0))[0]
    assert np.ptp(want) > 1
    near = np.abs(got - want) <= 1e-3
    assert near.mean() >= 0.95, (near.mean(), np.abs(got - want).max())


@pytest.mark.parametrize("stored", [np.float32, np.float16])
def test_memory_is_what_a_dry_run_counts(stored: type, rng: np.random.Generator) -> None:
    weights, (layout, views) = random_weights(rng, WIDTHS), some_views(rng)
    dry = DryKernels(on_gpu=False)
    for kernels in (dry, _backends.load("warp")):
        device = Device(kernels, "cpu")  # type: ignore[arg-type]  # it does what is asked of it
        arena = Arena(device)
        network = Network(arena, weights, layout, COUNT, stored=stored)
        if kernels is not dry:
            network.load(device.image(views), None)
        else:
            network.load(DryArray(views.shape, views.itemsize), None)
    there = sum(buffer.capacity for _, buffer in [*arena._free, *arena._named.values()])
    kept = np.prod(views.shape) * views.itemsize + layout.offsets.size * 4
    assert dry.bytes == there + kept


@pytest.fixture
def written(tmp_path: Path, rng: np.random.Generator) -> tuple[Path, dict[str, np.ndarray]]:
    """A file of weights, and its content."""
    weights = random_weights(rng, WIDTHS) | {"share": np.ones(4, np.float32), "spread": np.ones(3, np.float32)}
    np.savez(tmp_path / "weights.npz", **weights, version=VERSION)
    return tmp_path / "weights.npz", weights


def test_what_is_no_file_of_weights_is_refused(
    tmp_path: Path, written: tuple[Path, dict[str, np.ndarray]], scene: LightField
) -> None:
    def refusal(content: object) -> str:
        path = tmp_path / "wrong.npz"
        if isinstance(content, str):
            path.write_text(content)
        elif content is not None:
            np.savez(path, **content)
        shown = lfgpu("depth", tmp_path, "-o", tmp_path / "out", "--weights", path)
        with pytest.raises(LightFieldError) as refused:
            estimate_depth(scene, weights=path)
        assert shown.code == 1
        assert shown.err == f"lfgpu: {refused.value}\n"
        return shown.err

    weights = written[1]
    bias = weights["level1.0.bias"]
    for content, sentence in (
        (None, "it does not exist"),
        ("text", "it is damaged, or another kind of file; give one that `lfgpu train` wrote."),
        ({"a": np.zeros(3)}, "holds no weights of a network"),
        ({"level0.weight": np.array(["a"])}, "another kind of file"),
        (weights | {"version": VERSION + 1}, f"version {VERSION + 1}, but this lfgpu uses version {VERSION}"),
        ({name: values for name, values in weights.items() if name != "share"}, "share is missing"),
        (weights | {"level1.0.bias": bias[1:]}, "level1.0.bias has shape [15], not [16]"),
        (weights | {"level1.0.bias": np.nan * bias}, "level1.0.bias holds NaN or infinity"),
        ({name: values for name, values in weights.items() if "back3" not in name}, "does not fit the network"),
    ):
        assert sentence in refusal(content)
    with pytest.raises(LightFieldError, match="File name too long"):
        estimate_depth(scene, weights="a" * 5000)


def test_weights_are_read_as_they_were_written(written: tuple[Path, dict[str, np.ndarray]]) -> None:
    path, weights = written
    read = read_weights(path)
    assert set(read) == set(weights)
    assert all(np.array_equal(read[name], weights[name]) for name in weights)


def test_weights_of_a_file_are_used_recorded_and_exported(
    written: tuple[Path, dict[str, np.ndarray]], scene: LightField, tmp_path: Path
) -> None:
    """On all ways: Python, the command line, pipelines, batch's workers, C++; and a result says which they were."""
    path = written[0]
    options = {"disparity_range": RANGE, "check_cameras": False}
    theirs, ours = (estimate_depth(scene, weights=file, **options) for file in (path, BUILT_IN))
    assert not np.allclose(theirs.disparity, ours.disparity, atol=0.1)
    built_in = estimate_depth(scene, config="learned", **options)
    np.testing.assert_array_equal(ours.disparity, built_in.disparity)
    pipeline = DepthPipeline(scene, config="learned", weights=path, disparity_range=RANGE)
    np.testing.assert_array_equal(pipeline.estimate().disparity, theirs.disparity)
    views = estimate_all_views(scene, weights=path, keys=1, disparity_range=RANGE, check_cameras=False)
    np.testing.assert_array_equal(views.reference.disparity, theirs.disparity)
    with DepthStream(scene, weights=path, disparity_range=RANGE, device="cpu") as stream:
        np.testing.assert_array_equal(stream.push(scene.views).numpy(), theirs.disparity)
    with DepthStream.for_cameras(
        scene.positions, scene.size, weights=path, disparity_range=RANGE, device="cpu"
    ) as stream:
        assert stream.config == theirs.config
    assert len({theirs.config, ours.config, built_in.config}) == 3  # plans of one are no plans of the others
    assert pickle.loads(pickle.dumps(theirs.config)).weights.weights.keys() == written[1].keys()
    write_hci(scene, tmp_path / "scene")
    arguments = "--weights", path, "--disparity-range", f"{RANGE[0]},{RANGE[1]}"
    assert lfgpu("depth", tmp_path / "scene", "-o", tmp_path / "out", *arguments).code == 0
    kept = load(tmp_path / "out")
    np.testing.assert_array_equal(kept.disparity, theirs.disparity)
    assert kept.config == theirs.config
    assert kept.config.weights.startswith("weights.npz (SHA-256 ")
    with pytest.raises(LightFieldError, match="a result does not hold them"):
        DepthPipeline(scene, config=kept.config, disparity_range=RANGE)
    write_hci(scene, tmp_path / "frames" / "0")
    for command, source, record in (("export", "scene", "pipeline.json"), ("live", "frames", "live.json")):
        assert lfgpu(command, tmp_path / source, "-o", tmp_path / command, "--device", "cpu", *arguments).code == 0
        about = json.loads((tmp_path / command / record).read_text())
        assert about["config"]["weights"] == theirs.config.weights
    export_pipeline(scene, tmp_path / "python", weights=path, disparity_range=RANGE)
    assert (tmp_path / "python" / "pipeline.json").read_text() == (tmp_path / "export" / "pipeline.json").read_text()
    np.savez(path, **{name: 2 * values for name, values in written[1].items()}, version=VERSION)
    assert configured("learned", path) != theirs.config
    for config in ("accurate", "fast", "paper"):
        with pytest.raises(LightFieldError, match="only the presets learned and surest have"):
            estimate_depth(scene, config=config, weights=path)
    refused(
        lfgpu("depth", tmp_path / "boxes", "-o", tmp_path / "out", "--preset", "accurate", "--weights", path),
        "weights are for a network",
    )


RANGE = (-1.4, 1.4)


@pytest.fixture(scope="module")
def scene() -> LightField:
    return scenes.make("bars", grid=(5, 5), size=(64, 96))


@pytest.fixture(scope="module")
def found(scene: LightField) -> DepthResult:
    return estimate_depth(scene, config="learned", disparity_range=RANGE)


def test_the_preset_finds_thin_things_better_than_sweeps(scene: LightField, found: DepthResult) -> None:
    swept = evaluate(estimate_depth(scene, config="accurate", disparity_range=RANGE), scene.truth)
    assert evaluate(found, scene.truth).badpix_07 < 0.8 * swept.badpix_07
    assert evaluate(found, scene.truth).mse_100 < swept.mse_100


WIDE = (-12.0, 12.0)  # 96 steps of the network, which compares 64


@pytest.fixture(scope="module")
def wide() -> LightField:
    return scenes.make("boxes", grid=(5, 5), size=(128, 128), disparity_range=WIDE)


def test_turned_surfaces_in_wide_ranges_are_exact(wide: LightField, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second network improves the map of the first one, whose compared disparities lie far apart."""
    method, given = method_of("learned"), {"config": "learned", "disparity_range": WIDE}
    before = method.halo(wide.layout, Measured(WIDE, 0.01))
    twice = evaluate(estimate_depth(wide, **given), wide.truth)
    monkeypatch.setattr(aggregation, "are_in_windows", lambda *_: False)
    monkeypatch.setattr("lfgpu.methods.matching.method.are_in_windows", lambda *_: False)
    KEPT.free()  # the plan, which has the second network
    once = evaluate(estimate_depth(wide, **given), wide.truth)
    KEPT.free()
    assert twice.badpix_07 < 0.85 * once.badpix_07
    assert twice.badpix_03 < 0.9 * once.badpix_03
    assert twice.mse_100 < 1.1 * once.mse_100
    assert np.all(np.array(before) >= np.array(method.halo(wide.layout, Measured(WIDE, 0.01))) + NETWORK_REACH)


@pytest.mark.thorough
def test_backends_agree_in_wide_ranges(wide: LightField) -> None:
    pytest.importorskip("taichi")
    small = wide.crop(slice(32, 96), slice(32, 96))
    maps = [
        estimate_depth(small, config="learned", disparity_range=WIDE, backend=backend, device="cpu").disparity
        for backend in ("warp", "taichi")
    ]
    assert np.quantile(np.abs(maps[0] - maps[1]), 0.95) < 1e-3


@pytest.mark.parametrize("name", ["textureless", *map(thorough, ("boxes", "planes"))])
def test_its_confidence_is_the_share_of_right_pixels(name: str) -> None:
    """On scenes that the weights of the confidence were not fitted on."""
    lf = scenes.make(name, grid=(5, 5), size=(96, 96))
    result = estimate_depth(lf, config="learned", disparity_range=(-1.6, 1.6))
    assert lf.truth is not None
    right = np.abs(result.disparity - lf.truth.disparity) <= 0.07
    assert np.mean(right) == pytest.approx(np.mean(result.confidence), abs=0.1)
    sure = result.confidence > 0.9
    assert np.mean(~right[sure]) < 0.2 * np.mean(~right[~sure])


def test_the_surest_map_is_chosen_from_both(scene: LightField, found: DepthResult) -> None:
    both = PRESETS["surest"]
    sweeps = replace(both, tuning=replace(both.tuning, passes="matching"))
    swept, surest = (estimate_depth(scene, config=config, disparity_range=RANGE) for config in (sweeps, both))
    low, high = np.minimum(swept.disparity, found.disparity), np.maximum(swept.disparity, found.disparity)
    assert np.mean((surest.disparity > low - 0.03) & (surest.disparity < high + 0.03)) > 0.95
    assert scene.truth is not None
    of_network, of_sweeps, of_both = (
        np.abs(result.disparity - scene.truth.disparity) <= 0.07 for result in (found, swept, surest)
    )
    differ = of_network != of_sweeps
    assert differ.mean() > 0.02
    assert of_both[differ].mean() > 0.6  # a coin would be right in half of them
    assert of_both.mean() > max(of_network.mean(), of_sweeps.mean()) - 0.01
    assert np.mean(of_both) == pytest.approx(np.mean(surest.confidence), abs=0.1)
    with DepthStream(scene, config="surest", disparity_range=RANGE, policy="block") as stream:
        for frame in range(2):  # a cold and a warm one
            assert np.mean(np.abs(stream.push(scene.views).numpy() - surest.disparity) < 0.03) > 0.9, frame


def test_decisions_are_those_of_pytorch(rng: np.random.Generator) -> None:
    torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install lfgpu[train]")
    from benchmarks.choosing import chosen
    from lfgpu.training import network as trained
    from lfgpu.training.weights import fold

    torch.manual_seed(int(rng.integers(2**31)))
    network = trained.Choice(WIDTHS).eval()
    device = Device(_backends.load("warp"), "cpu")
    choice = Choice(Arena(device), fold(network.state_dict()), (64, 96), stored=np.float32)
    image = rng.random((64, 96, 3)).astype(np.float32)
    first, second = ([rng.random((64, 96)).astype(np.float32) for _ in range(5)] for _ in range(2))
    outputs = {f"{name}_out": device.zeros((64, 96)) for name in ("disparity", "confidence", "variance")}
    fields = [[device.field(values) for values in some] for some in (first, second)]
    choice.see(device.image(image), device.scalar(1.5), *fields, farthest=1.0, span=2.0)
    features, seen = (
        torch.tensor(device.kernels.numpy(volume)[0].transpose(2, 0, 1)) for volume in (choice.features, choice.image)
    )
    given = (torch.nn.functional.pixel_shuffle(part, FOLD)[None] for part in (features, seen[: 3 * FOLD**2]))
    with torch.no_grad():
        decisions = network(*given)
        want = chosen(torch.tensor(np.stack([first[0], second[0]]))[None], decisions)[0].numpy()
    device.kernels.choose(choice(), fields[0][0], fields[1][0], farthest=1.0, **outputs)
    got = {name: device.kernels.numpy(values) for name, values in outputs.items()}
    np.testing.assert_allclose(got["disparity_out"], want, atol=1e-4)
    np.testing.assert_allclose(got["confidence_out"], decisions[0, 1].sigmoid(), atol=1e-4)
    np.testing.assert_allclose(np.log(got["variance_out"]) / 2, decisions[0, 2].clamp(-7, 4), atol=1e-3)


def test_rows_grey_views_and_masks(scene: LightField, found: DepthResult) -> None:
    row = scene.subset(np.flatnonzero(scene.pattern("cross") & (scene.offsets[:, 1] == 0)))
    assert evaluate(estimate_depth(row, config="learned", disparity_range=RANGE), row.truth).badpix_07 < 15
    grey = replace(scene, views=scene.views.mean(-1, keepdims=True).astype(np.uint8))
    without = estimate_depth(grey, config="learned", disparity_range=RANGE)
    assert np.mean(np.abs(without.disparity - found.disparity) < 0.07) > 0.9
    lf = masked(scene, np.s_[:, 60:])
    holes = np.isnan(estimate_depth(lf, config="learned", disparity_range=RANGE).disparity)
    assert np.array_equal(holes, ~lf.valid[12])


def test_streams_pipelines_and_estimates_give_one_map(scene: LightField, found: DepthResult) -> None:
    want = found.disparity
    pipeline = DepthPipeline(scene, config="learned", disparity_range=RANGE)
    np.testing.assert_allclose(pipeline.estimate().disparity, want, atol=1e-5)
    with DepthStream(scene, config="learned", disparity_range=RANGE, policy="block") as stream:
        for frame in range(2):  # a cold and a warm one
            assert np.mean(np.abs(stream.push(scene.views).numpy() - want) < 0.03) > 0.95, frame


def test_the_map_of_the_network_weighs_more_where_it_is_surer(
    scene: LightField, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A map that is sure stays as it is, one that is not goes where the views lead it, unless it is drawn back."""
    monkeypatch.setattr(Alignment, "_draw_back", lambda *_: None)
    config = PRESETS["learned"]
    assert isinstance(config, MatchingConfig)
    moved = []
    for weight in (1e-6, 0.04, 1e3):
        result = estimate_depth(scene, config=config.with_tuning({"alignment.matched": weight}), disparity_range=RANGE)
        moved.append(float(np.abs(result.stages["align"] - result.stages["sweep"]).mean()))
    assert moved[0] > 1.2 * moved[1] > 3 * moved[2]


def test_training_says_what_it_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    refused(lfgpu("train", "-o", tmp_path / "weights.npz"), "lfgpu train needs torch, which is not installed; install")
    refused(lfgpu("train", "-o", tmp_path / "weights.pt"), "weights.pt must end in .npz")
    refused(lfgpu("train", "-o", tmp_path / "weights.npz", "--side", 50), "--side must be a multiple of 32, not 50")
