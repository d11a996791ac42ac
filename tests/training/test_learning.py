"""Sector costs against their definition in float64, batches, and a network that learns; without PyTorch all skip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="PyTorch is not installed: pip install lfgpu[train]")

from lfgpu.training.generator import Batch, Generator  # noqa: E402
from lfgpu.training.network import MULTIPLE, Network, estimate, peak  # noqa: E402
from lfgpu.training.sectors import SECTORS, UNIT, order_of_sectors, sector_costs  # noqa: E402
from lfgpu.training.train import Settings, Trainer, labels_for  # noqa: E402


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
    """Ranges hold all of it, windows most."""
    batch, rng = generator.draw(5, 4), np.random.default_rng(0)
    for _ in range(20):
        first, steps, count = labels_for(batch, rng)
        assert first.shape == batch.truth.shape
        place = (batch.truth - first) / steps[:, None, None]
        inside = ((place >= 0) & (place <= count - 1)).float().mean()
        assert inside > (0.7 if count in (12, 16) else 0.999) or count == 20


def test_any_array_gives_logits(generator: Generator) -> None:
    batch = generator.draw(0, 1)
    logits = estimate(
        Network((4, 4, 4, 4)), batch.views, batch.reference, batch.offsets, batch.starts,
        margin=batch.margin, first=torch.zeros_like(batch.truth), steps=torch.ones(1), count=8,
    )  # fmt: skip
    assert logits.shape == (1, 8, MULTIPLE, MULTIPLE)


@pytest.mark.thorough
def test_a_network_learns_and_goes_on_where_it_ended(tmp_path: Path) -> None:
    settings = Settings(steps=60, scenes=2, side=MULTIPLE)
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
