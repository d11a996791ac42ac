"""Sector costs against their definition in float64, batches, and a network that learns; without PyTorch all skip."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import lfgpu, refused

from lfgpu import estimate_depth, scenes
from lfgpu._backends import open_device
from lfgpu.io import write_hci
from lfgpu.methods.matching.choice import read_choice
from lfgpu.methods.matching.learned import BUILT_IN, read_weights, weights_file, weights_of

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install lfgpu[train]")

from benchmarks.choosing import chosen, draw, loss_of, train_choice  # noqa: E402
from lfgpu.training.compared import Windows, count_of, disparities_for  # noqa: E402
from lfgpu.training.facets import facets  # noqa: E402
from lfgpu.training.generator import Batch, Generator  # noqa: E402
from lfgpu.training.network import MULTIPLE, Network, estimate, peak  # noqa: E402
from lfgpu.training.rig import measured_rig  # noqa: E402
from lfgpu.training.run import run  # noqa: E402
from lfgpu.training.sectors import SECTORS, UNIT, order_of_sectors, sector_costs  # noqa: E402
from lfgpu.training.train import Settings, Trainer  # noqa: E402
from lfgpu.training.weights import fold, write_weights  # noqa: E402

torch.set_num_threads(1)  # small volumes: several threads would wait for each other, most of all on a busy machine

ON_CPU = {"backend": "warp", "device": "cpu"}


@pytest.fixture(scope="module")
def generator() -> Generator:
    return Generator((1,), "cpu", side=MULTIPLE, textures=20, rays=1)


def costs_of(batch: Batch, first: object, count: int) -> object:
    steps = torch.ones(len(batch.truth))
    return sector_costs(
        batch.views, batch.reference, batch.offsets, batch.starts,
        margin=batch.margin, first=first, steps=steps, count=count,
    )  # fmt: skip


def bilinear(image: np.ndarray, x: float, y: float) -> np.ndarray:
    x0, y0 = min(int(x), image.shape[1] - 2), min(int(y), image.shape[0] - 2)
    a, b = x - x0, y - y0
    return (
        (1 - b) * ((1 - a) * image[y0, x0] + a * image[y0, x0 + 1])
        + b * ((1 - a) * image[y0 + 1, x0] + a * image[y0 + 1, x0 + 1])
    )  # fmt: skip


def test_sector_costs_are_those_of_their_definition() -> None:
    rng = np.random.default_rng()
    offsets = rng.uniform(-1, 1, (9, 2))
    order, starts = order_of_sectors(offsets)
    offsets = offsets[order]
    views, reference = rng.random((1, 9, 14, 15, 3)), rng.random((1, 10, 11, 3))
    first, steps = rng.uniform(-3, 0, (1, 10, 11)), rng.uniform(0.5, 2, 1)
    found = sector_costs(
        torch.tensor(views, dtype=torch.float32), torch.tensor(reference, dtype=torch.float32), offsets, starts,
        margin=2, first=torch.tensor(first, dtype=torch.float32), steps=torch.tensor(steps, dtype=torch.float32),
        count=4,
    ).numpy()  # fmt: skip
    sector = np.rint(np.arctan2(offsets[:, 1], offsets[:, 0]) / (np.pi / 4)).astype(int) % SECTORS
    compared = 0
    for label in range(4):
        for y in range(10):
            for x in range(11):
                d = first[0, y, x] + label * steps[0]
                each: dict[int, list[np.ndarray]] = {}
                places = np.stack([x + 2 - d * offsets[:, 0], y + 2 - d * offsets[:, 1]], 1)
                if (np.abs(places - np.rint(places)) < 1e-4).any():
                    continue
                for n, (px, py) in enumerate(places):
                    if 0 <= px <= 14 and 0 <= py <= 13:
                        each.setdefault(int(sector[n]), []).append(bilinear(views[0, n], px, py) - reference[0, y, x])
                pairs = {s: (np.abs(r).mean(), np.abs(np.mean(r, 0)).mean()) for s, r in each.items()}
                pairs = {s: np.log1p(np.array(c) / UNIT) / 4 for s, c in pairs.items()}
                other = np.mean(list(pairs.values()), 0) if pairs else np.ones(2)
                expected = np.array([pairs.get(s, other) for s in range(SECTORS)]).T.ravel()
                np.testing.assert_allclose(found[0, :, label, y, x], expected, atol=2e-3)
                compared += 1
    assert compared > 300


@pytest.mark.parametrize("seed", range(4))
def test_costs_are_least_at_the_truth(generator: Generator, seed: int) -> None:
    """Whether a batch is turned or not: offsets, sectors and pictures stay together."""
    batch = generator.draw(seed, 4)
    for each in (batch, batch.turned(np.random.default_rng(seed))):
        totals = []
        for away in (-4, 0, 4):  # costs at the truth of each pixel, from those at all whole disparities around
            low = float(each.truth.min()) - 6
            count = int(float(each.truth.max()) - low) + 8
            costs = costs_of(each, torch.full_like(each.truth, low), count).mean(1)
            place = (each.truth + away - low).clamp(0, count - 1)
            totals.append(float(costs.gather(1, place.round().long()[:, None]).mean()))
        assert totals[1] < min(totals[0], totals[2])


def test_batches_are_the_same_for_the_same_seed(generator: Generator) -> None:
    first, again = generator.draw(3, 2), generator.draw(3, 2)
    assert torch.equal(first.views, again.views)
    assert not torch.equal(first.views.sum(), generator.draw(4, 2).views.sum())


def test_the_peak_is_the_mean_around_the_likeliest_disparity() -> None:
    logits = torch.full((1, 9, 1, 1), -30.0)
    logits[0, 3:5] = 0.0
    disparity = peak(logits, torch.tensor([[[-2.0]]]), torch.tensor([0.5]))
    assert disparity.item() == pytest.approx(-2 + 0.5 * 3.5)


def test_drawn_disparities_hold_the_truth(generator: Generator) -> None:
    batch, rng = generator.draw(5, 4), np.random.default_rng(0)
    for number in range(20):
        first, steps, count = disparities_for(batch, rng, count_of(number))
        assert first.shape == batch.truth.shape
        place = (batch.truth - first) / steps[:, None, None]
        assert place.min() >= 1.4
        assert place.max() <= count - 2.4


def test_any_array_gives_logits(generator: Generator) -> None:
    batch = generator.draw(0, 1)
    logits = estimate(Network((4, 4, 4, 4)), batch, torch.zeros_like(batch.truth), torch.ones(1), 8)
    assert logits.shape == (1, 8, MULTIPLE, MULTIPLE)


TINY = {"scenes": 2, "side": MULTIPLE, "unseen": 2}


@pytest.mark.thorough
def test_a_network_learns_and_goes_on_where_it_ended(tmp_path: Path) -> None:
    settings = Settings(steps=60, **TINY)
    trainer = Trainer(settings, tmp_path, "cpu")
    batch = trainer.generator.draw(0, 2)
    rng = np.random.default_rng(0)
    losses = [float(trainer.learn(batch, rng)["loss"].detach()) for _ in range(40)]
    assert np.mean(losses[-5:]) < 0.75 * np.mean(losses[:5])
    trainer.write()
    again = Trainer(settings, tmp_path, "cpu")
    assert again.step == 40
    for name, value in trainer.mean.state_dict().items():
        assert torch.equal(value, again.mean.state_dict()[name])


def test_training_begins_where_weights_are(tmp_path: Path) -> None:
    """The network with normalisations is the function that the folded weights are, and folds to them again."""
    weights = read_weights(BUILT_IN)
    trainer = Trainer(Settings(steps=1, **TINY), tmp_path, "cpu", start=weights)
    folded = fold(trainer.network.state_dict())
    assert folded.keys() == weights.keys() - {"share", "spread"}
    for name, values in folded.items():
        largest = np.abs(weights[name]).max()
        np.testing.assert_allclose(values, weights[name], atol=1e-3 * largest)
    found = trainer.validate()
    assert found.errors["bad 0.28"] < 0.6  # of random weights: 0.99


def test_a_rig_is_what_its_light_fields_are() -> None:
    """Positions, range, noise, brightness and colours are measured, and generated light fields have them."""
    options = {"grid": (1, 5), "size": (64, 96), "disparity_range": (-0.4, 1.6), "noise": 0.02}
    lf = scenes.make("boxes", **options)
    rig = measured_rig([lf, replace(lf, views=lf.views.mean(-1, keepdims=True).astype(np.uint8))], **ON_CPU)
    assert not rig.is_grey
    rig = measured_rig([replace(lf, views=(0.5 * lf.views).mean(-1, keepdims=True).astype(np.uint8))], **ON_CPU)
    assert rig.arrays == (((-1.0, 0.0), (-0.5, 0.0), (0.5, 0.0), (1.0, 0.0)),)
    assert rig.limits == pytest.approx((-0.8, 3.2), abs=0.9)
    assert rig.grain == pytest.approx(0.5 * 0.02 / np.sqrt(3), rel=0.3)
    assert rig.levels == 255
    assert rig.is_grey
    generator = Generator((2,), "cpu", side=64, textures=20, rays=1, rig=rig)
    means, truths = [], []
    for number in range(4):
        batch = generator.draw(number, 4)
        assert sorted(batch.offsets.tolist()) == [[-1, 0], [-0.5, 0], [0.5, 0], [1, 0]]
        assert torch.equal(batch.views[..., 0], batch.views[..., 2])
        means.append(float(batch.reference.mean()))
        truths.append(batch.truth.numpy())
        turned = batch.turned(np.random.default_rng(number), keep=True)
        assert sorted(turned.offsets.tolist()) == sorted(batch.offsets.tolist())
        first, steps, count = disparities_for(batch, np.random.default_rng(number), 48, rig.limits)
        assert float(first.max()) < rig.limits[0] + 0.5
        assert float((first[:, 0, 0] + steps * (count - 1)).min()) > rig.limits[1] - 0.5
    assert np.mean(means) == pytest.approx(rig.level, rel=0.25)
    low, high = np.quantile(truths, (0.03, 0.97))
    assert rig.limits[0] - 0.3 < low < rig.limits[0] + 1.5
    assert rig.limits[1] - 1.5 < high < rig.limits[1] + 0.3


def test_the_command_fits_weights_in_pieces(tmp_path: Path) -> None:
    """From a light field to a file of weights with its picture and its log, which an estimate uses."""
    lf = scenes.make("boxes", grid=(1, 5), size=(32, 48))
    write_hci(lf, tmp_path / "rig")
    out = tmp_path / "weights.npz"
    command = "train", "--like", tmp_path / "rig", "-o", out, "--steps", 2, "--batch", 2, "--device", "cpu"
    first = lfgpu(*command, "--minutes", 0)
    assert (first.code, first.err) == (0, "")
    assert "0 of 2 steps: the same command goes on" in first.out
    begun = estimate_depth(lf, weights=out).disparity
    assert np.mean(np.abs(begun - estimate_depth(lf, config="learned").disparity) < 0.02) > 0.9
    done = lfgpu(*command)
    assert (done.code, done.err) == (0, "")
    assert "2 of 2 steps" in done.out
    folder = tmp_path / "weights.training"
    assert {path.name for path in folder.iterdir()} == {"state.pt", "log.jsonl", "validation.png"}
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    assert [(line["step"], "unseen" in line) for line in lines] == [(0, True), (2, False), (2, True)]
    assert estimate_depth(lf, weights=out).config.weights.startswith("weights.npz")
    refused(lfgpu(*command, "--seed", 1, "--quiet"), "holds a run with other settings (seed: 0, now 1)")


def test_two_processes_learn_the_same(tmp_path: Path) -> None:
    settings = Settings(steps=2, **TINY)
    done, _ = run(settings, tmp_path / "run", tmp_path / "weights.npz", devices=("cpu", "cpu"), seconds=600)
    assert done == 2
    alone = Trainer(settings, tmp_path / "alone", "cpu")
    alone.run(600)
    both = torch.load(tmp_path / "run" / "state.pt")["network"]
    assert not all(torch.equal(value, both[name]) for name, value in alone.network.state_dict().items())


def test_windows_lie_around_a_map_that_was_found(tmp_path: Path) -> None:
    settings = Settings(steps=2, **TINY)
    trainer = Trainer(settings, tmp_path / "run", "cpu", start=weights_of(""), compared=Windows)
    batch = Generator((2,), "cpu", side=2 * MULTIPLE, textures=20, rays=1, spans=(12.0, 30.0)).draw(0, 2)
    first, steps, count = trainer._compared(batch, np.random.default_rng(0), 0)
    assert first.shape == batch.truth.shape
    last = first + (count - 1) * steps[:, None, None]
    assert ((first < batch.truth) & (batch.truth < last)).float().mean() > 0.6
    assert float(batch.truth.max() - batch.truth.min()) > 1.5 * float((last - first).max())  # no window holds all
    trainer.run(600)
    assert trainer.step == 2


def test_facets_are_those_of_the_reference() -> None:
    rng = np.random.default_rng()
    maps = torch.from_numpy(rng.normal(size=(2, 9, 11)))
    device = open_device("reference", "cpu")
    for map_, got in zip(maps.numpy(), facets(maps).numpy(), strict=True):
        planes, want = np.zeros((*map_.shape, 4)), np.zeros(map_.shape)
        device.kernels.planes(map_, planes_out=planes)
        device.kernels.facets(planes, facets_out=want)
        np.testing.assert_allclose(got, want, atol=1e-9)


def test_a_choice_learns(tmp_path: Path) -> None:
    """On a few light fields, whose maps it tells apart afterwards; masked pixels count for nothing."""
    weights = weights_file(BUILT_IN)
    seen = draw(2, seed=1, device="cpu", side=64, weights=weights, on_light_field=lambda _: None)
    assert torch.isfinite(seen.features).all()
    losses = []
    for steps in (1, 120):
        network = train_choice(seen, steps=steps, seed=0)
        with torch.no_grad():
            decisions = network(seen.features.float(), seen.image.float())
        losses.append(float(loss_of(decisions, seen)))
        errors = (chosen(seen.maps, decisions) - seen.truth).abs().clamp(max=4).nanmean()
    assert losses[1] < losses[0] - 0.1
    assert float(errors) < float((seen.maps - seen.truth[:, None]).abs().clamp(max=4).nanmean((0, 2, 3)).max())
    seen.truth[:, 5:9] = torch.nan
    unseen = decisions.clone()
    unseen[..., 5:9, :] += 1
    assert torch.equal(loss_of(unseen, seen), loss_of(decisions, seen))
    write_weights(tmp_path / "choice.npz", network.state_dict())
    written = read_choice(tmp_path / "choice.npz")
    assert written.keys() == fold(network.state_dict()).keys()
    again = train_choice(seen, steps=1, seed=1, start=written)
    with torch.no_grad():
        decisions = again(seen.features.float(), seen.image.float())
    assert float(loss_of(decisions, seen)) < losses[0] - 0.1  # begun where the other one ended
