"""`lfgpu batch`: depth for many light fields, with a folder of results for each, even if some fail."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lfgpu._backends import backend_named
from lfgpu.cli import values
from lfgpu.cli.options import Computing, Deterministic, OutFolder, Parameters, Quiet, ReadingIncomplete, Views
from lfgpu.errors import LightFieldError
from lfgpu.printable import printable

if TYPE_CHECKING:
    from rich.console import Console

    from lfgpu.batch.run import Summary

_INTERRUPTED = 130
_NAMED = 5  # failures and folders that are printed by name; the report lists all


@dataclass(frozen=True)
class _Workers(Computing):
    """Options of the estimates of all workers."""

    device: Annotated[
        str | None,
        typer.Option(
            metavar="DEVICE", help="cpu, cuda, cuda:1, vulkan or metal.", show_default="all GPUs, else the CPU"
        ),
    ] = None
    threads: Annotated[
        int | None,
        typer.Option(min=1, help="CPU threads per worker.", show_default="an equal share of the cores"),
    ] = None


def batch(
    ctx: typer.Context,
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT...",
            help="Light fields, folders that are searched for light fields, or patterns such as 'scans/*'.",
        ),
    ],
    out: OutFolder,
    *,
    sequence: Annotated[
        bool,
        typer.Option(
            "--sequence", help="Treat the light fields of a folder as frames: one worker processes them in order."
        ),
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS",
            help="Address of a Dask scheduler, such as tcp://host:8786.",
            show_default="a local cluster",
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Number of local worker processes.", show_default="one per GPU, or one")
    ] = None,
    retries: Annotated[
        int, typer.Option(min=0, help="Number of times that an item is tried again after its worker died.")
    ] = 3,
    item_timeout: Annotated[
        float, typer.Option(min=1, metavar="SECONDS", help="An item that takes longer is given up.")
    ] = 7200,
    parameters: Parameters,
    chosen: Views,
    computing: _Workers,
    deterministic: Deterministic = False,
    reading: ReadingIncomplete,
    report: Annotated[
        bool,
        typer.Option(
            "--report", help="Also write a report of each item, to which report.html leads: 1 to 3 MB and seconds each."
        ),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the disparity of many light fields, on all GPUs of this machine or on a Dask cluster.

    Each light field gets a folder of results below FOLDER. manifest.jsonl records what happened to each one. Run the
    same command again to compute only what is missing, failed or out of date. At the end, report.html shows all
    results.
    """
    from lfgpu.batch.cluster import BatchError, Cluster
    from lfgpu.batch.items import find_items
    from lfgpu.batch.report import write_report
    from lfgpu.batch.run import Batch
    from lfgpu.batch.work import Settings
    from lfgpu.cli.console import output, waiting
    from lfgpu.cli.failures import command_line, is_interruption
    from lfgpu.io import check_writable
    from lfgpu.threads import get_threads

    check_writable(out)
    how = Settings(
        config=parameters.config(),
        disparity_range=values.parse_range("--disparity-range", computing.disparity_range),
        place=chosen.place(),
        pattern=chosen.pattern,
        reading=reading.options(),
        backend=backend_named(computing.backend),
        deterministic=deterministic,
        report=report,
        command=command_line(ctx),
    )
    lasting: dict[str, Any] = {"retries": retries, "item_timeout": item_timeout}
    device, threads = computing.device, computing.threads
    if scheduler is None:
        devices = devices_of(computing.backend, device)
        count = workers or len(devices)
        share = threads or max(1, get_threads() // count)
        cluster = Cluster(workers=count, devices=devices, threads=share, **lasting)
    else:
        if workers is not None:
            raise LightFieldError(
                "--workers sets the size of a local cluster, but --scheduler names another cluster; give one of the "
                "two."
            )
        devices = () if device is None else (device,)
        cluster = Cluster(scheduler=scheduler, devices=devices, threads=threads, **lasting)
    items, barren = find_items(
        inputs,
        sequence=sequence,
        format_name=reading.format_name,
        pattern=reading.names,
        frame=reading.frame,
        leave_out=out,
    )

    work, title = Batch(items, out, how), out.resolve().name
    try:
        with waiting(quiet=quiet, counts=True) as show:
            work.run(
                cluster,
                on_progress=lambda now: show(_said(now), now.computed + len(now.failed), now.todo),
            )
    except BaseException as error:
        if not is_interruption(error):
            raise
        done = work.summary.kept + work.summary.computed
        typer.echo(
            f"lfgpu: interrupted after {done} of {len(items)} items; run the same command again to continue.", err=True
        )
        raise typer.Exit(_INTERRUPTED) from None
    summary = work.summary
    write_report(summary, out, title)
    if not quiet:
        _show(output(), summary, out, barren)
    if summary.failed:
        named = "; ".join(f"{entry['item']}: {entry['error'].rstrip('.')}" for entry in summary.failed[:_NAMED])
        more = f"; and {len(summary.failed) - _NAMED} more" if len(summary.failed) > _NAMED else ""
        raise BatchError(f"{len(summary.failed)} of {len(items)} items failed: {named}{more}.")


def devices_of(backend: str, device: str | None) -> tuple[str, ...]:
    """Return the devices of local workers; BackendError if the backend or the device is missing."""
    from lfgpu._backends import alike, load, pick_device

    kernels = load(backend)
    best = pick_device(kernels, device)
    return (best,) if device is not None else alike(kernels, best)


def _said(summary: Summary) -> str:
    """Describe for the display how a batch fares."""
    parts = [f"{summary.computed} done, {len(summary.failed)} failed, {summary.kept} kept, {summary.workers} workers"]
    if summary.last is not None:
        parts.append(f"last: {printable(summary.last['item'])}")
    if summary.dashboard:
        parts.append(f"dashboard: {summary.dashboard}")
    return "; ".join(parts)


def _show(console: Console, summary: Summary, out: Path, barren: list[Path]) -> None:
    from lfgpu.batch.items import ITEM_FILES, MANIFEST_FILE
    from lfgpu.batch.manifest import DONE
    from lfgpu.batch.report import facts
    from lfgpu.cli import console as shown
    from lfgpu.cli.summary import show_next, show_outputs
    from lfgpu.io import REPORT_FILE

    shown.heading(console, out.resolve().name)
    shown.lines(console, facts(summary))
    if barren:
        more = f" and {len(barren) - _NAMED} more" if len(barren) > _NAMED else ""
        shown.lines(console, [("no light field in", ", ".join(map(str, barren[:_NAMED])) + more)])
    files = [name for name in ITEM_FILES if name != REPORT_FILE]
    show_outputs(
        console,
        out,
        [
            ("ITEM/", f"{', '.join(files)}, with --report {REPORT_FILE}"),
            (MANIFEST_FILE, "status, parameters, time and scores of each item"),
            (REPORT_FILE, "all results on one page"),
        ],
    )
    done = [item for item in summary.items if summary.entries.get(item.name, {}).get("status") == DONE]
    show_next(console, *(("lfgpu", "view", item.source, out / item.name) for item in done[:1] if item.frame is None))
