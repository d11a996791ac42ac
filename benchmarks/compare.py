"""Comparison of two runs: measurements that got slower or faster beyond chance, larger errors, missing measurements."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.results import Record, Run, load
from benchmarks.tables import duration

_ALLOWED_ERRORS = {
    # measure: (factor, in its unit): an error has grown if it is more than factor times the old one plus this
    "relative": (1.5, 1e-7),  # sums in another order differ in the last digits
    "mse_100": (1.02, 1e-3),
    "badpix_07": (1.02, 0.05),
    "badpix_03": (1.02, 0.05),
    "badpix_01": (1.02, 0.05),
    "q25": (1.02, 1e-3),
    "energy": (1.01, 0.0),
}


@dataclass(frozen=True)
class Comparison:
    """Sentences, by what they are about."""

    warnings: list[str]
    slower: list[str]
    faster: list[str]
    worse: list[str]
    """Measurements of a larger error, or that failed and did not before."""
    only: list[str]
    """In one of the two alone."""
    compared: int

    @property
    def fails(self) -> bool:
        """True if something is slower or worse."""
        return bool(self.slower or self.worse)


def compare(old: Run, new: Run, threshold: float) -> Comparison:
    """Compare; times differ if the medians do by more than `threshold` (0.1 is 10 %) and no quartiles overlap."""
    before, after = ({record.key: record for record in run.records} for run in (old, new))
    both = [(before[key], after[key]) for key in before if key in after]
    slower, faster = [], []
    for a, b in both:
        if a.seconds is None or b.seconds is None:
            continue
        change = b.seconds.median / a.seconds.median
        text = f"{_name(b)}: {duration(a.seconds.median)} → {duration(b.seconds.median)} ({100 * (change - 1):+.0f} %)"
        if change > 1 + threshold and b.seconds.q1 > a.seconds.q3:
            slower.append(text)
        elif 1 / change > 1 + threshold and b.seconds.q3 < a.seconds.q1:
            faster.append(text)
    return Comparison(
        list(_differences(old, new)),
        slower,
        faster,
        [line for a, b in both for line in _worse(a, b)],
        [f"{_name(r)}: only in the old one" for key, r in before.items() if key not in after]
        + [f"{_name(r)}: only in the new one" for key, r in after.items() if key not in before],
        len(both),
    )


def _worse(old: Record, new: Record) -> Iterator[str]:
    if new.failed and not old.failed:
        yield f"{_name(new)}: failed ({new.failed})"
    for measure, (factor, more) in _ALLOWED_ERRORS.items():
        if measure in old.errors and measure in new.errors:
            a, b = old.errors[measure], new.errors[measure]
            if not b <= factor * a + more:  # also where it is not a number
                yield f"{_name(new)}: error {measure} {a:.3g} → {b:.3g}"


def _differences(old: Run, new: Run) -> Iterator[str]:
    if old.machine != new.machine or old.threads != new.threads:
        named = [*sorted(old.machine.keys() | new.machine.keys())]
        pairs = [(name, old.machine.get(name), new.machine.get(name)) for name in named]
        pairs.append(("threads", old.threads, new.threads))
        what = "; ".join(f"{name} {a} and {b}" for name, a, b in pairs if a != b)
        if old.place != new.place:
            yield f"these runs are from different machines or settings, so their times say little: {what}."
        else:
            yield f"the software of the machine changed: {what}."


def _name(record: Record) -> str:
    return " ".join(filter(None, (record.backend, record.device, record.kind, record.case, record.name)))


def command(
    old: Annotated[Path, typer.Argument(metavar="OLD.json")],
    new: Annotated[Path, typer.Argument(metavar="NEW.json")],
    threshold: Annotated[float, typer.Option(min=0, help="Percent.")] = 10,
) -> None:
    """Say what got slower, faster or worse; exit with 1 if something got slower or worse."""
    found = compare(load(old), load(new), threshold / 100)
    for warning in found.warnings:
        typer.echo(f"warning: {warning}", err=True)
    lists = {"slower": found.slower, "faster": found.faster, "worse": found.worse, "not in both": found.only}
    for title, lines in lists.items():
        for line in lines:
            typer.echo(f"{title}: {line}")
    typer.echo(
        f"{found.compared} compared, {len(found.slower)} slower, {len(found.faster)} faster, {len(found.worse)} worse."
    )
    if found.fails:
        raise typer.Exit(1)
