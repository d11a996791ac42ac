"""Tables of a run: operations, whole methods, accuracy, ablation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from statistics import geometric_mean

import typer

from benchmarks import bandwidth
from benchmarks.cases import CASES
from benchmarks.errors import BenchmarkError
from benchmarks.options import Files
from benchmarks.pipelines import MATCHING, RESIDENT, SCIPY, SCRATCH
from benchmarks.results import Record, Run, load, merged, save
from benchmarks.tables import NONE, Table, console, duration

RANGES = FOUND, TRUE = "found", "true"
"""The range of disparities: found by the estimate, or the true one with a margin."""

WHOLE = "accurate"
"""The variant of the ablation that leaves nothing out."""

_LEAST = {"mse_100": 0.01, "badpix_07": 0.1, "badpix_01": 0.1}  # smaller errors count as these: a few pixels
_RATIOS = {"mse_100": "MSE", "badpix_07": "BadPix 0.07", "badpix_01": "BadPix 0.01"}
_MATTERS = 1.05  # ratio of two MSE in the ablation
_MANY = 50  # repeats, with which a 99 % quantile says something
_BUSY = 0.5  # load average
_METRICS = {
    "mse_100": ("MSE×100", "{:.3f}"),
    "badpix_07": ("BadPix 0.07", "{:.1f} %"),
    "badpix_03": ("0.03", "{:.1f} %"),
    "badpix_01": ("0.01", "{:.1f} %"),
    "q25": ("Q25×100", "{:.2f}"),
}

Cell = Callable[[Record], str]


def command(files: Files) -> None:
    """Print results as Markdown, a section for each machine."""
    typer.echo("\n".join(markdown(run) for run in merged(map(load, files))), nl=False)


def finish(run: Run, out: Path | None) -> None:
    """Save and show a run; BenchmarkError if nothing was measured."""
    if out is not None:
        save(run, out)
    to = console()
    for line in headings(run):
        to.print(line)
    for table in tables(run.records):
        table.show()
    for heading, lines in _remarks(run).items():
        for line in lines:
            to.print(f"{heading.lower()}: {line}")
    if not any(record.seconds for record in run.records):
        raise BenchmarkError("nothing could be measured, see above.")


def markdown(run: Run) -> str:
    """Write a run as a section of a page."""
    parts = [f"### {run.where}", *headings(run)[1:]]
    parts += [f"**{table.title}**\n\n{table.markdown}" for table in tables(run.records)]
    parts += [f"{heading}:\n\n" + "\n".join(f"- {line}" for line in lines) for heading, lines in _remarks(run).items()]
    return "\n\n".join(parts) + "\n"


def headings(run: Run) -> list[str]:
    """Say where, when and with which versions the run was made, a sentence each."""
    m, v = run.machine, run.versions
    driver = f", driver {m['driver']}" if m.get("driver") else ""
    software = ", ".join(f"{name} {version}" for name, version in v.items() if version)
    lines = [
        f"{run.where}; {m.get('system')}{driver}.",
        f"{run.date[:10]}, {run.threads} threads; Python {m.get('python')}, {software}"
        + (f"; commit {run.commit[:10]}{'+' if run.commit.endswith('+') else ''}." if run.commit else "."),
    ]
    if run.load is not None and run.load > _BUSY:
        lines.append(f"The machine was not idle: its load average was {run.load:.1f} when the run began.")
    return lines


def tables(records: Sequence[Record]) -> list[Table]:
    """Make all tables that have rows."""
    done = [record for record in records if record.seconds is not None]
    whole = [r for case in CASES for r in _of(done, "pipeline", case.name)]
    ways = {SCRATCH: "The whole method from scratch; preset paper"}
    for preset, name in (("paper", RESIDENT), *zip(MATCHING, MATCHING, strict=True)):
        ways[name] = f"The resident method, a light field after the other; preset {preset}"
    made = [
        *(_operations(case.name, _of(done, "operation", case.name)) for case in CASES),
        *(_whole(title, [r for r in whole if r.name == name]) for name, title in ways.items()),
        _solvers([r for r in whole if r.name in (RESIDENT, SCIPY)]),
        _bandwidth(sorted(_of(done, "bandwidth"), key=lambda r: r.device)),
        *_ablations(_of(done, "ablation")),
        *_accuracies(_of(done, "accuracy")),
    ]
    return [table for table in made if table.rows]


def against(run: Run, baseline: Run) -> Table:
    """Compare errors with a baseline of the same scenes, presets and ranges: ratios in the mean and at worst."""
    old = {(r.name, r.case): r for r in _of(baseline.records, "accuracy") if not r.failed}
    new = [r for r in _of(run.records, "accuracy") if not r.failed]
    pairs = [(r, old[r.name, r.case]) for r in new if (r.name, r.case) in old]
    return _compared("Accuracy, ratios to the baseline", pairs)


def _remarks(run: Run) -> dict[str, list[str]]:
    """List what could not be measured, and why."""
    failed: dict[tuple[str, str], list[str]] = {}
    for r in run.records:
        if r.failed:
            failed.setdefault((" ".join(filter(None, (r.backend, r.device, r.case))), r.failed), []).append(r.name)
    lines = [
        *(f"{s.backend} {s.device}: {s.reason}" for s in run.skipped),
        *(f"{where} {', '.join(names)}: {reason}" for (where, reason), names in failed.items()),
    ]
    return {"Not measured": lines} if lines else {}


# --- columns ---


def _time(r: Record) -> str:
    assert r.seconds is not None
    return duration(r.seconds.median)


def _quartiles(r: Record) -> str:
    assert r.seconds is not None
    return NONE if r.seconds.n == 1 else f"{duration(r.seconds.q1)} – {duration(r.seconds.q3)}"


def _p99(r: Record) -> str:
    assert r.seconds is not None
    return duration(r.seconds.p99) if r.seconds.n >= _MANY else NONE


def _captured(r: Record) -> str:
    return "yes" if r.details.get("captured") else NONE


def _megabytes(size: int | None) -> str:
    return NONE if size is None else f"{size / 1e6:.0f} MB"


_WHAT: dict[str, Cell] = {"case": lambda r: r.case, "backend": lambda r: r.backend, "device": lambda r: r.device}
_TIMES: dict[str, Cell] = {"time": _time, "quartiles": _quartiles}
_N: dict[str, Cell] = {"n": lambda r: str(r.seconds.n if r.seconds else 0)}
_ERRORS: dict[str, Cell] = {
    title: lambda r, measure=measure, form=form: form.format(r.errors[measure])  # type: ignore[misc]
    for measure, (title, form) in _METRICS.items()
}
_MEMORY: dict[str, Cell] = {"host": lambda r: _megabytes(r.host_bytes), "GPU": lambda r: _megabytes(r.gpu_bytes)}


def _ratio(records: Sequence[Record]) -> Cell:
    """Make the cell of a time over that of the fastest backend on the same device."""

    def cell(record: Record) -> str:
        what = record.device, record.name, record.case
        medians = [r.seconds.median for r in records if r.seconds and (r.device, r.name, r.case) == what]
        return f"{record.seconds.median / min(medians):.3g}" if record.seconds else NONE

    return cell


# --- tables ---


def _operations(case: str, records: list[Record]) -> Table:
    frames = list(dict.fromkeys(r.details["frame"] for r in records))
    longest: dict[str, float] = {}
    for r in records:
        longest[r.name] = max(longest.get(r.name, 0.0), r.seconds.median if r.seconds else 0.0)
    columns: dict[str, Cell] = {
        "frame": lambda r: r.details["frame"],
        "operation": lambda r: f"`{r.details['operation']}`",
        **{name: _WHAT[name] for name in ("backend", "device")},
        "calls": lambda r: str(r.details["count"]),
        **_TIMES,
        **_N,
        "captured": _captured,
        "ratio": _ratio(records),
        "of limit": lambda r: f"{100 * r.limit / r.seconds.median:.2g} %" if r.limit and r.seconds else NONE,
    }
    order = sorted(records, key=lambda r: (frames.index(r.details["frame"]), -longest[r.name]))
    return Table.of(f"Operations, {case}", 4, order, columns)


def _whole(title: str, records: list[Record]) -> Table:
    """Make a table with the 99 % quantile where there are enough repeats, and what was captured where something can."""
    stages = list(dict.fromkeys(stage for r in records for stage in r.details["stages"]))
    columns: dict[str, Cell] = {
        **_WHAT,
        **_TIMES,
        **({"p99": _p99} if any(r.seconds.n >= _MANY for r in records if r.seconds) else {}),
        **_N,
        **({"captured": _captured} if any("captured" in r.details for r in records) else {}),
        "ratio": _ratio(records),
        **{
            stage: lambda r, stage=stage: duration(r.details["stages"][stage])  # type: ignore[misc]
            for stage in stages
        },
        "iterations": lambda r: str(r.details["iterations"]),
        **_ERRORS,
        **_MEMORY,
    }
    return Table.of(f"{title}, scene boxes", 3, records, columns)


def _solvers(records: list[Record]) -> Table:
    """Put the solver on the device beside scipy's, which it has to reach; differences are of energies."""
    scipy = {(r.case, r.backend, r.device): r for r in records if r.name == SCIPY}
    pairs = [
        (r, scipy[r.case, r.backend, r.device])
        for r in records
        if r.name == RESIDENT and (r.case, r.backend, r.device) in scipy
    ]
    apart = {id(r): 100 * (r.errors["energy"] / other.errors["energy"] - 1) for r, other in pairs}
    columns: dict[str, Cell] = {
        **_WHAT,
        "solver": lambda r: "lbfgs" if r.name == RESIDENT else "lbfgsb (scipy)",
        "time": _time,
        "iterations": lambda r: str(r.details["iterations"]),
        "energy": lambda r: f"{r.errors['energy']:.6g}",
        "difference": lambda r: f"{apart[id(r)]:+.2f} %" if id(r) in apart else NONE,
        **_ERRORS,
    }
    title = "The solver of the refinement; preset paper, scene boxes"
    return Table.of(title, 4, [r for pair in pairs for r in pair], columns)


def _bandwidth(records: list[Record]) -> Table:
    columns: dict[str, Cell] = {
        **{name: _WHAT[name] for name in ("backend", "device")},
        "operation": lambda r: r.name,
        "bandwidth": lambda r: f"{bandwidth.of(r) / 1e9:.3g} GB/s",
    }
    return Table.of("Memory bandwidth", 3, records, columns)


def _ablations(records: list[Record]) -> Iterator[Table]:
    """Make the table of means over scenes, and then one of each scene."""
    cases = {record.case: [r for r in records if r.case == record.case] for record in records}
    yield _worth(list(cases.values()))
    for case, found in cases.items():
        judging = " (for judging: no parameter was chosen by it)" if found[0].details["judging"] else ""
        columns: dict[str, Cell] = {
            "variant": lambda r: r.name,
            "device": _WHAT["device"],
            **_ERRORS,
            "time": _time,
        }
        yield Table.of(f"Ablation, {case}{judging}", 2, found, columns)


def _worth(cases: list[list[Record]]) -> Table:
    """Compare MSE, BadPix(0.07) and BadPix(0.01) of each variant with the whole method on the same scene.

    Scenes for judging stand apart, so that the mean is over those that parameters may have been chosen by.
    """
    by_name = [({r.name: r for r in found}, bool(found[0].details["judging"])) for found in cases]
    known = [(found, judging) for found, judging in by_name if WHOLE in found]
    rows = []
    for name in dict.fromkeys(name for found, _ in known for name in found):
        row = [name]
        for judging in (False, True):
            pairs = [(found[name], found[WHOLE]) for found, apart in known if apart == judging and name in found]
            row += [_mean_ratio(pairs, measure) for measure in _LEAST]
            worse = sum(r.errors["mse_100"] > _MATTERS * whole.errors["mse_100"] for r, whole in pairs)
            better = sum(_MATTERS * r.errors["mse_100"] < whole.errors["mse_100"] for r, whole in pairs)
            row += [] if judging else [f"{worse} / {better} of {len(pairs)}"]
        rows.append(tuple(row))
    columns = ("variant", *_RATIOS.values(), "worse / better", *(f"{title}, for judging" for title in _RATIOS.values()))
    return Table(f"Ablation, ratios to {WHOLE}, geometric means over scenes", columns, 1, rows)


def _accuracies(records: list[Record]) -> Iterator[Table]:
    """Make a table of each preset and range, and one of the errors with the range found against those with the true."""
    titles = {**{measure: title for measure, (title, _) in _METRICS.items()}, "ause": "AUSE", "span": "range / true"}
    columns: dict[str, Cell] = {
        "scene": lambda r: r.case,
        **{
            title: lambda r, measure=measure: f"{r.errors[measure]:.3g}"  # type: ignore[misc]
            for measure, title in titles.items()
        },
        "time": _time,
    }
    for name in dict.fromkeys(r.name for r in records):
        yield Table.of(f"Accuracy, {name}", 1, [r for r in records if r.name == name], columns)
    true = {(r.details["preset"], r.case): r for r in records if r.details["range"] == TRUE}
    found = [r for r in records if r.details["range"] == FOUND and (r.details["preset"], r.case) in true]
    pairs = [(r, true[r.details["preset"], r.case]) for r in found]
    yield _compared("Accuracy, the range found against the true one", pairs)


def _compared(title: str, pairs: list[tuple[Record, Record]]) -> Table:
    """Compare errors of pairs: for each preset and range geometric means of ratios, and the worst scene by name."""
    rows = []
    for name in dict.fromkeys(new.name for new, _ in pairs):
        these = [(new, old) for new, old in pairs if new.name == name]
        ratios = {measure: {new.case: _error_ratio(new, old, measure) for new, old in these} for measure in _RATIOS}
        worst = [max(ratios[measure].items(), key=lambda item: item[1]) for measure in _RATIOS]
        means = (f"{geometric_mean(ratios[measure].values()):.2f}" for measure in _RATIOS)
        rows.append((name, str(len(these)), *means, *(f"{case} {ratio:.2f}" for case, ratio in worst)))
    columns = ("preset", "scenes", *_RATIOS.values(), *(f"worst {title}" for title in _RATIOS.values()))
    return Table(title, columns, 1, rows)


def _mean_ratio(pairs: list[tuple[Record, Record]], measure: str) -> str:
    return f"{geometric_mean(_error_ratio(a, b, measure) for a, b in pairs):.2f}" if pairs else NONE


def _error_ratio(new: Record, old: Record, measure: str) -> float:
    return max(new.errors[measure], _LEAST[measure]) / max(old.errors[measure], _LEAST[measure])


def _of(records: Iterable[Record], kind: str, case: str | None = None) -> list[Record]:
    return [r for r in records if r.kind == kind and case in (None, r.case)]
