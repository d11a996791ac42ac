"""Time, memory and error of every backend; a GPU held against the reference; several GPUs; limited memory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks import (
    batches,
    cases,
    gpu_parity,
    machine,
    measuring,
    operations,
    pipelines,
    scaling,
    suite,
    tiles,
    viewer,
)
from benchmarks.cli.options import (
    Backends,
    CaseNames,
    Device,
    Out,
    Presets,
    Seconds,
    check_known,
    known_backend,
    listed,
)
from benchmarks.cli.outputs import check_out, collected, finish, say
from benchmarks.errors import BenchmarkError
from benchmarks.operation import Operation
from lfgpu._backends import list_backends
from lfgpu.io.atomic import check_writable
from lfgpu.threads import get_threads

_PIPELINES_HELP = f'{", ".join(pipelines.NAMES)}; default: all; or "none".'


def measure(
    context: typer.Context,
    case_names: Annotated[
        str, typer.Option("--cases", metavar="NAME,...", help="ROWSxCOLUMNSxHEIGHTxWIDTH; default: those for minutes.")
    ] = "",
    operation_names: Annotated[
        str, typer.Option("--operations", metavar="NAME,...", help='Default: all; "none" measures none.')
    ] = "",
    backends: Annotated[str, typer.Option(metavar="NAME,...", help="Default: all.")] = "",
    devices: Annotated[
        str, typer.Option(metavar="NAME,...", help="cpu, cuda:0 ...; default: the CPU and the first GPU.")
    ] = "",
    repeats: Annotated[
        int, typer.Option(min=1, help="Most repeats of a call; long calls are repeated less often.")
    ] = 15,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads of the CPU; default: one for each core.")] = None,
    timeout: Annotated[float, typer.Option(min=1, help="Seconds that one process may take.")] = 600,
    pipeline_names: Annotated[
        str,
        typer.Option("--pipelines", metavar="NAME,...", help=_PIPELINES_HELP),
    ] = "",
    runs: Annotated[int, typer.Option(min=1, help="Repeats of the resident method on a GPU.")] = 50,
    startup: Annotated[bool, typer.Option(help="Import and time to the first result.")] = True,
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="Where the results go.")] = None,
) -> None:
    """Measure time, memory and error of every backend on every device, and print a table."""
    if context.invoked_subcommand is not None:
        return
    plan = suite.Plan(
        cases=tuple(cases.find(n) for n in listed(case_names)) or tuple(c for c in cases.CASES if c.default),
        operations=_operations(operation_names),
        backends=tuple(known_backend(n) for n in listed(backends)) or list_backends(),
        devices=tuple("cuda:0" if n == "cuda" else n for n in listed(devices)) or None,
        pipelines=_pipelines(pipeline_names),
        startup=startup,
        repeats=repeats,
        runs=runs,
        threads=threads or get_threads(),
        timeout=timeout,
    )
    check_out(out)
    finish(suite.run(plan, say), out)


def _operations(text: str) -> tuple[Operation, ...]:
    if text == "none":
        return ()
    return tuple(operations.find(name) for name in listed(text)) or operations.OPERATIONS


def _pipelines(text: str) -> tuple[str, ...]:
    names = () if text == "none" else tuple(listed(text)) or pipelines.NAMES
    check_known(names, "pipeline", pipelines.NAMES)
    return names


def range_(
    case_names: CaseNames = "9x9x512x512",
    preset: Annotated[str, typer.Option(metavar="NAME", help="Whose noise is measured.")] = "accurate",
    backends: Backends = "warp",
    seconds: Seconds = 5.0,
    device: Device = None,
    out: Out = None,
) -> None:
    """What it takes to find the disparity range and the noise before an estimate, from host to host."""
    check_out(out)
    chosen = tuple(known_backend(name) for name in listed(backends))
    named = tuple(cases.find(name) for name in listed(case_names))
    rows = measuring.run(named, preset, chosen, device, say, seconds=seconds)
    measuring.show(collected(rows, out, machine.about()))


def gpu_parity_(
    backend: Annotated[str, typer.Option(metavar="NAME")] = "warp",
    device: Annotated[str, typer.Option(metavar="DEVICE")] = "cuda:0",
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.json", help="Where the results go.")] = (
        gpu_parity.RESULT
    ),
) -> None:
    """Test every operation on a GPU against the reference; the file names the commit. Exits with 1 on failures."""
    check_writable(out, folder=False)
    for found in gpu_parity.run(known_backend(backend), device, say):
        gpu_parity.save(found, out)  # as far as it is
    if not found["passed"]:
        raise BenchmarkError(f"nothing could be tested on {backend} {device}: is the device there?")
    typer.echo(f"{found['passed']} passed, {found['skipped']} skipped, {len(found['failed'])} failed: {out}")
    if found["failed"]:
        raise typer.Exit(1)


def scaling_(
    case_names: CaseNames = "7x7x375x375,9x9x512x512",
    presets: Presets = "fast,accurate",
    devices: Annotated[str, typer.Option(metavar="NAME,...", help="Default: all GPUs, or the CPU.")] = "",
    counts: Annotated[str, typer.Option(metavar="N,...", help="On how many of them; default: 1, 2, 4 and all.")] = "",
    how: Annotated[str, typer.Option(metavar="KIND", help=f"{' or '.join(scaling.KINDS)}, one for each device.")] = (
        scaling.KINDS[0]
    ),
    seconds: Annotated[float, typer.Option(min=0, help="For each measurement.")] = 5,
    out: Out = None,
) -> None:
    """Measure light fields in a second on 1, 2, 4 .. GPUs of this machine."""
    names = tuple("cuda:0" if n == "cuda" else n for n in listed(devices)) or scaling.devices_here()
    wanted = _gpu_counts(counts, len(names))
    check_out(out)
    plan = scaling.Plan(
        tuple(cases.find(n) for n in listed(case_names)), tuple(listed(presets)), names, wanted, how, seconds
    )
    rows = scaling.run(plan, say)
    if out is not None:
        scaling.save(rows, out)
    typer.echo(scaling.table(rows), nl=False)


def batches_(
    case_name: Annotated[str, typer.Option("--case", metavar="NAME")] = "9x9x512x512",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "fast",
    kinds: Annotated[str, typer.Option(metavar="KIND,...", help="What the items are.")] = ",".join(batches.KINDS),
    counts: Annotated[str, typer.Option(metavar="N,...", help="On how many GPUs; default: 1, 2, 4 and all.")] = "",
    items: Annotated[int, typer.Option(min=10, help="For each worker.")] = 100,
    per_gpu: Annotated[str, typer.Option(metavar="N,...", help="Workers for each GPU.")] = "1",
    threads: Annotated[int, typer.Option(min=1, help="CPU threads of each worker.")] = 4,
    out: Out = None,
) -> None:
    """Measure the items in a second that `lfgpu batch` does on 1, 2, 4 .. GPUs of this machine, and where they wait."""
    wanted = _gpu_counts(counts, len(scaling.devices_here()))
    check_out(out)
    rows = batches.run(
        cases.find(case_name),
        preset,
        listed(kinds),
        [(gpus, int(n)) for n in listed(per_gpu) for gpus in wanted],
        items=items,
        threads=threads,
        say=say,
    )
    if out is not None:
        scaling.save(rows, out)
    typer.echo(batches.table(rows), nl=False)


def tiles_(
    case_name: Annotated[str, typer.Option("--case", metavar="NAME")] = "17x17x960x1280",
    preset: Annotated[str, typer.Option(metavar="NAME")] = "accurate",
    device: Annotated[str | None, typer.Option(metavar="NAME", help="Default: all GPUs, or the CPU.")] = None,
    max_memory: Annotated[
        str, typer.Option(metavar="SIZE,...", help='One estimate for each; "none" for no limit and no tiles.')
    ] = "8GiB",
) -> None:
    """Estimate a light field of planes within a given memory; say what it took in time and memory."""
    limits = [None if name == "none" else name for name in listed(max_memory)]
    for found in tiles.measure(cases.find(case_name), preset, device, limits):
        for name, value in found.items():
            typer.echo(f"{name:<12} {value}")


def viewer_(
    case_name: Annotated[str, typer.Option("--case", metavar="ROWSxCOLUMNSxHEIGHTxWIDTH")] = "17x17x960x1280",
    times: Annotated[int, typer.Option(min=1, help="Requests after the first one; their median is given.")] = 5,
    out: Out = None,
) -> None:
    """What each kind of picture costs the server of `lfgpu view`: CPU time and wall time."""
    check_out(out)
    about = {**machine.about(), "case": case_name}
    viewer.show(collected(viewer.run(cases.parse(case_name), times, say), out, about, key="pictures"))


def _gpu_counts(text: str, there: int) -> tuple[int, ...]:
    """The numbers in a text; of an empty one 1, 2, 4 and all."""
    return tuple(int(n) for n in listed(text)) or tuple(sorted({1, *(n for n in (2, 4) if n <= there), there}))
