"""`lfgpu doctor`: what is installed here, what it runs on, and whether it computes what it should."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import nullcontext
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from lfgpu.cli.checkup import Cache, Checkup, Device, Part, Trial


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON, for bug reports.")] = False,
) -> None:
    """Examine this installation: versions, devices, kernels, memory, optional parts, and a self-test with a verdict.

    The self-test estimates a small scene on every device and compares the map with the ground truth and with the
    reference backend. It takes about ten seconds; the first run compiles kernels and takes longer. The exit code is 1
    if something does not work.
    """
    from lfgpu.cli.checkup import examine
    from lfgpu.cli.console import waiting

    with nullcontext() if as_json else waiting("testing every device on a small scene"):
        found = examine()
    if as_json:
        typer.echo(json.dumps(found.as_dict(), indent=1))
    else:
        _show(found)
    if found.problems:
        raise typer.Exit(1)


def _show(found: Checkup) -> None:
    from lfgpu.cli.console import heading, lines, output, remark

    console = output()
    for title, facts in (
        ("Versions", list(found.versions.items())),
        ("Devices", [(device.backend, _device(device)) for device in found.devices]),
        ("Kernel cache", [(cache.backend, _cache(cache)) for cache in found.caches]),
        ("Memory", list(_memory(found))),
        ("Optional parts", [(part.extra, _part(part)) for part in found.parts]),
        ("Self-test", [(trial.what, _trial(trial)) for trial in found.trials]),
    ):
        heading(console, title)
        lines(console, facts)
    heading(console, "Verdict")
    for sentence in found.problems or ("Everything that is installed works.",):
        remark(console, sentence)


def _device(device: Device) -> str:
    memory = f", {_size(device.memory_bytes)}" if device.memory_bytes else ""
    return ": ".join(filter(None, [device.device, device.name])) + memory


def _cache(cache: Cache) -> str:
    return f"{cache.folder}, {_size(cache.bytes)}" + ("" if cache.writable else ", cannot be written to")


def _memory(found: Checkup) -> Iterator[tuple[str, str]]:
    for label, size in found.memory.items():
        yield label, "unknown" if size is None else f"{_size(size)}{' free' * (label == 'temporary files')}"
    yield "threads", str(found.threads)


def _part(part: Part) -> str:
    if not part.missing:
        return f"installed: {part.purpose}"
    return f"not installed: {part.purpose}; pip install -e '.[{part.extra}]'"


def _trial(trial: Trial) -> str:
    if trial.problem:
        return f"failed after {trial.seconds:.1f} s"
    distances = "".join(
        f", {distance:.1g} px from the {what}"
        for what, distance in (("ground truth", trial.from_truth), ("reference", trial.from_reference))
        if distance is not None
    )
    return f"passed in {trial.seconds:.1f} s{distances}"


def _size(size: int) -> str:
    return f"{size / 2**30:.1f} GiB" if size >= 2**30 else f"{size / 2**20:.1f} MiB"
