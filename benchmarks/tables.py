"""What was measured, as tables of text."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from statistics import geometric_mean

from benchmarks import bandwidth, population
from benchmarks.ablation import ALL
from benchmarks.cases import CASES
from benchmarks.pipelines import MATCHING, RESIDENT, SCIPY, SCRATCH
from benchmarks.results import Record, Run

NONE = "–"
_LEAST = {"mse_100": 0.01, "badpix_07": 0.1, "badpix_01": 0.1}  # errors that the ablation tells apart from none
_RATIOS = {"mse_100": "MSE", "badpix_07": "BadPix 0.07", "badpix_01": "BadPix 0.01"}
_MATTERS = 1.05  # ratio of two MSE in the ablation
_MANY = 50  # repeats, with which a 99 % quantile says something
_FOUND, _TRUE = population.RANGES
_METRICS = {
    "mse_100": "MSE×100",
    "badpix_07": "BadPix 0.07",
    "badpix_03": "0.03",
    "badpix_01": "0.01",
    "q25": "Q25×100",
}


@dataclass(frozen=True)
class Table:
    """Text in rows; the first `labels` columns are words, the others numbers."""

    title: str
    columns: tuple[str, ...]
    labels: int
    rows: Sequence[tuple[str, ...]]


def headings(run: Run) -> list[str]:
    """Where, when and with what: a sentence each."""
    m, v = run.machine, run.versions
    driver = f", driver {m['driver']}" if m.get("driver") else ""
    software = ", ".join(f"{name} {version}" for name, version in v.items() if version)
    lines = [
        f"{run.where}; {m.get('system')}{driver}.",
        f"{run.date[:10]}, {run.threads} threads; Python {m.get('python')}, {software}"
        + (f"; commit {run.commit[:10]}{'+' if run.commit.endswith('+') else ''}." if run.commit else "."),
    ]
    if run.load is not None and run.load > 0.5:
        lines.append(f"The machine was not idle: its load average was {run.load:.1f} when the run began.")
    return lines


def tables(records: Sequence[Record]) -> list[Table]:
    """All tables that have rows."""
    done = [record for record in records if record.seconds is not None]
    whole = [r for case in CASES for r in _of(done, "pipeline", case.name)]
    made = [
        *(_operations(case.name, _of(done, "operation", case.name)) for case in CASES),
        _whole("The whole method from scratch; preset paper", [r for r in whole if r.name == SCRATCH]),
        *(
            _whole(f"The resident method, a light field after the other; preset {preset}", records)
            for preset, name in (("paper", RESIDENT), *zip(MATCHING, MATCHING, strict=True))
            if (records := [r for r in whole if r.name == name])
        ),
        _solvers([r for r in whole if r.name in (RESIDENT, SCIPY)]),
        _bandwidth(_of(done, "bandwidth")),
        _startup(_of(done, "startup")),
        *_ablations(_of(done, "ablation")),
        *_accuracies(_of(done, population.KIND)),
    ]
    return [table for table in made if table.rows]


def against(run: Run, baseline: Run) -> Table:
    """Ratios of errors to a baseline of the same scenes, presets and ranges: geometric means, and the worst scene."""
    old = {(r.name, r.case): r for r in _of(baseline.records, population.KIND) if not r.failed}
    new = [r for r in _of(run.records, population.KIND) if not r.failed]
    pairs = [(r, old[r.name, r.case]) for r in new if (r.name, r.case) in old]
    return _compared("Accuracy, ratios to the baseline", pairs)


def remarks(run: Run) -> list[str]:
    """What could not be measured, and why."""
    failed: dict[tuple[str, str], list[str]] = {}
    for r in run.records:
        if r.failed:
            failed.setdefault((" ".join(filter(None, (r.backend, r.device, r.case))), r.failed), []).append(r.name)
    return [
        *(f"{s.backend} {s.device}: {s.reason}" for s in run.skipped),
        *(f"{where} {', '.join(names)}: {reason}" for (where, reason), names in failed.items()),
    ]


def doubts(run: Run) -> list[str]:
    """What was measured but is wrong: a time that says nothing."""
    return [
        f"{r.backend} {r.device} {r.case} {r.name}: error {r.errors['relative']:.1g}, more than "
        f"{r.details['tolerance']:.1g}"
        for r in _of(run.records, "operation")
        if r.seconds is not None and not r.errors["relative"] <= r.details["tolerance"]
    ]


def duration(seconds: float) -> str:
    """Three digits and a unit."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 0.9995:
            return f"{_digits(seconds * factor)} {unit}"
    return f"{_digits(seconds * 1e6)} µs"


def _operations(case: str, records: list[Record]) -> Table:
    columns = (
        *("operation", "backend", "device", "time", "quartiles", "n", "captured", "ratio", "of limit", "error"),
        *("host", "GPU"),
    )
    rows = []
    names = list(dict.fromkeys(record.name for record in records))
    for r in sorted(records, key=lambda r: names.index(r.name)):
        assert r.seconds is not None
        rows.append(
            (
                r.name,
                r.backend,
                r.device,
                duration(r.seconds.median),
                _quartiles(r),
                str(r.seconds.n),
                _captured(r),
                _ratio(r, records),
                NONE if r.limit is None else f"{100 * r.limit / r.seconds.median:.2g} %",
                f"{r.errors['relative']:.1g}",
                _megabytes(r.host_bytes),
                _megabytes(r.gpu_bytes),
            )
        )
    return Table(f"Operations, {case}", columns, 3, rows)


def _whole(title: str, records: list[Record]) -> Table:
    """The 99 % quantile where there are enough repeats, and what was captured where something can be."""
    stages = list(dict.fromkeys(stage for r in records for stage in r.details["stages"]))
    many = any(r.seconds.n >= _MANY for r in records if r.seconds)
    captured = any("captured" in r.details for r in records)
    columns = (
        *("case", "backend", "device", "time", "quartiles", *(["p99"] * many), "n", *(["captured"] * captured)),
        *("ratio", *stages, "iterations", *_METRICS.values(), "host", "GPU"),
    )
    rows = []
    for r in records:
        assert r.seconds is not None
        rows.append(
            (
                r.case,
                r.backend,
                r.device,
                duration(r.seconds.median),
                _quartiles(r),
                *([duration(r.seconds.p99) if r.seconds.n >= _MANY else NONE] * many),
                str(r.seconds.n),
                *([_captured(r)] * captured),
                _ratio(r, records),
                *(duration(r.details["stages"][stage]) for stage in stages),
                str(r.details["iterations"]),
                *_metrics(r),
                _megabytes(r.host_bytes),
                _megabytes(r.gpu_bytes),
            )
        )
    return Table(f"{title}, scene boxes", columns, 3, rows)


def _solvers(records: list[Record]) -> Table:
    """The solver on the device beside the one that it has to reach; differences are of energies, to scipy's."""
    columns = ("case", "backend", "device", "solver", "time", "iterations", "energy", "difference", *_METRICS.values())
    scipy = {_place(r): r for r in records if r.name == SCIPY}
    rows = []
    for resident in (r for r in records if r.name == RESIDENT and _place(r) in scipy):
        truth = scipy[_place(resident)]
        difference = resident.errors["energy"] / truth.errors["energy"] - 1
        for r, solver, apart in ((resident, "lbfgs", f"{100 * difference:+.2f} %"), (truth, "lbfgsb (scipy)", NONE)):
            assert r.seconds is not None
            rows.append(
                (
                    *_place(r),
                    solver,
                    duration(r.seconds.median),
                    str(r.details["iterations"]),
                    f"{r.errors['energy']:.6g}",
                    apart,
                    *_metrics(r),
                )
            )
    return Table("The solver of the refinement; preset paper, scene boxes", columns, 4, rows)


def _place(record: Record) -> tuple[str, str, str]:
    return record.case, record.backend, record.device


def _metrics(record: Record) -> list[str]:
    """What `_METRICS` names, in that order."""
    e = record.errors
    return [
        f"{e['mse_100']:.3f}",
        *(f"{e[name]:.1f} %" for name in ("badpix_07", "badpix_03", "badpix_01")),
        f"{e['q25']:.2f}",
    ]


def _captured(record: Record) -> str:
    return "yes" if record.details.get("captured") else NONE


def _bandwidth(records: list[Record]) -> Table:
    rows = [
        (r.backend, r.device, r.name, f"{bandwidth.of(r) / 1e9:.3g} GB/s")
        for r in sorted(records, key=lambda r: r.device)
    ]
    return Table("Memory bandwidth", ("backend", "device", "operation", "bandwidth"), 3, rows)


def _startup(records: list[Record]) -> Table:
    what = {"import": "import lfgpu", "cold": "first result, empty caches", "warm": "first result, filled caches"}
    rows = []
    for r in records:
        assert r.seconds is not None
        rows.append((r.backend, r.device, what[r.name], duration(r.seconds.median), _quartiles(r), str(r.seconds.n)))
    return Table("Start-up", ("backend", "device", "what", "time", "quartiles", "n"), 3, rows)


def _ablations(records: list[Record]) -> Iterator[Table]:
    """The means over scenes, and then each scene."""
    cases = {record.case: [r for r in records if r.case == record.case] for record in records}
    yield _worth(list(cases.values()))
    for case, found in cases.items():
        judging = " (for judging: no parameter was chosen by it)" if found[0].details["judging"] else ""
        rows = [(r.name, r.device, *_metrics(r), duration(r.seconds.median)) for r in found if r.seconds is not None]
        yield Table(f"Ablation, {case}{judging}", ("variant", "device", *_METRICS.values(), "time"), 2, rows)


def _worth(cases: list[list[Record]]) -> Table:
    """What each variant does to MSE, BadPix(0.07) and BadPix(0.01), as ratios to the whole method on the same scene.

    Scenes for judging stand apart, so that the mean is over those that parameters may have been chosen by.
    """
    by_name = [({r.name: r for r in found}, bool(found[0].details["judging"])) for found in cases]
    known = [(found, judging) for found, judging in by_name if ALL in found]
    rows = []
    for name in dict.fromkeys(name for found, _ in known for name in found):
        row = [name]
        for judging in (False, True):
            pairs = [(found[name], found[ALL]) for found, apart in known if apart == judging and name in found]
            row += [_mean_ratio(pairs, measure) for measure in _LEAST]
            worse = sum(r.errors["mse_100"] > _MATTERS * whole.errors["mse_100"] for r, whole in pairs)
            better = sum(_MATTERS * r.errors["mse_100"] < whole.errors["mse_100"] for r, whole in pairs)
            row += [] if judging else [f"{worse} / {better} of {len(pairs)}"]
        rows.append(tuple(row))
    columns = ("variant", *_RATIOS.values(), "worse / better", *(f"{title}, for judging" for title in _RATIOS.values()))
    return Table("Ablation, ratios to accurate, geometric means over scenes", columns, 1, rows)


def _mean_ratio(pairs: list[tuple[Record, Record]], measure: str) -> str:
    """Geometric mean; what is below `_LEAST` counts as that, since ratios of a few pixels say nothing."""
    if not pairs:
        return NONE
    return f"{geometric_mean(_error_ratio(a, b, measure) for a, b in pairs):.2f}"


def _error_ratio(new: Record, old: Record, measure: str) -> float:
    return max(new.errors[measure], _LEAST[measure]) / max(old.errors[measure], _LEAST[measure])


def _accuracies(records: list[Record]) -> Iterator[Table]:
    """Each preset and range, and then what finding the range does."""
    measures = {**_METRICS, "ause": "AUSE", "span": "range / true"}
    for name in dict.fromkeys(r.name for r in records):
        rows = [
            (r.case, *(f"{r.errors[m]:.3g}" for m in measures), duration(r.seconds.median))
            for r in records
            if r.name == name and r.seconds is not None
        ]
        yield Table(f"Accuracy, {name}", ("scene", *measures.values(), "time"), 1, rows)
    true = {(r.details["preset"], r.case): r for r in records if r.details["range"] == _TRUE}
    found = [r for r in records if r.details["range"] == _FOUND and (r.details["preset"], r.case) in true]
    yield _compared(
        "Accuracy, the range found against the true one", [(r, true[r.details["preset"], r.case]) for r in found]
    )


def _compared(title: str, pairs: list[tuple[Record, Record]]) -> Table:
    """Ratios of errors, geometric means and the worst by name, for each preset and range."""
    rows = []
    for name in dict.fromkeys(new.name for new, _ in pairs):
        these = [(new, old) for new, old in pairs if new.name == name]
        ratios = {measure: {new.case: _error_ratio(new, old, measure) for new, old in these} for measure in _RATIOS}
        worst = {measure: max(ratios[measure].items(), key=lambda item: item[1]) for measure in _RATIOS}
        rows.append(
            (
                name,
                str(len(these)),
                *(f"{geometric_mean(ratios[measure].values()):.2f}" for measure in _RATIOS),
                *(f"{case} {ratio:.2f}" for case, ratio in worst.values()),
            )
        )
    columns = ("preset", "scenes", *_RATIOS.values(), *(f"worst {title}" for title in _RATIOS.values()))
    return Table(title, columns, 1, rows)


def _of(records: Iterable[Record], kind: str, case: str | None = None) -> list[Record]:
    return [r for r in records if r.kind == kind and case in (None, r.case)]


def _ratio(record: Record, records: list[Record]) -> str:
    """To the fastest backend on the same device."""
    assert record.seconds is not None
    best = min(
        r.seconds.median
        for r in records
        if r.seconds is not None and (r.device, r.name, r.case) == (record.device, record.name, record.case)
    )
    return f"{record.seconds.median / best:.3g}"


def _quartiles(record: Record) -> str:
    assert record.seconds is not None
    return NONE if record.seconds.n == 1 else f"{duration(record.seconds.q1)} – {duration(record.seconds.q3)}"


def _digits(number: float) -> str:
    return f"{number:.3g}" if number < 999.5 else f"{number:.0f}"


def _megabytes(size: int | None) -> str:
    return NONE if size is None else f"{size / 1e6:.0f} MB"
