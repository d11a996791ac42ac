"""`lfgpu backends`: the backends, whether they can run here, and on which devices."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lfgpu._backends import BackendInfo


def backends() -> None:
    """List the backends: whether each is installed, its devices here, and how to install what is missing."""
    from lfgpu._backends import DEFAULT, describe_backends
    from lfgpu.cli.console import backend_rows, output

    backend_rows(
        output(),
        [
            (
                f"{info.name} (default)" if info.name == DEFAULT else info.name,
                f"{info.package} {info.version}" if info.version else f"{info.package}: not installed",
                _runs_on(info),
            )
            for info in describe_backends()
        ],
    )


def _runs_on(info: BackendInfo) -> list[str]:
    """Return one line per device; or why the backend cannot run, and what to do."""
    from lfgpu.machine import device_name

    if info.problem is not None:
        return [info.problem, *filter(None, [info.remedy])]
    return [f"{device}: {name}" if (name := device_name(device)) else device for device in info.devices]
