"""The estimate that options ask for, with its progress on the terminal."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from lfgpu._backends import DEFAULT, BackendName

if TYPE_CHECKING:
    from lfgpu.config import Config
    from lfgpu.data.lightfield import LightField
    from lfgpu.data.result import DepthResult
    from lfgpu.data.views_result import ViewsResult


@dataclass(frozen=True)
class Estimation:
    """The options of an estimate, which are checked before anything is read or computed."""

    config: Config
    disparity_range: tuple[float, float] | None = None
    backend: BackendName = DEFAULT
    device: str | None = None
    deterministic: bool = False
    max_memory: str | None = None

    def check_device(self) -> None:
        """Raise BackendError if the backend or the device is missing."""
        from lfgpu._backends import load, pick_device

        pick_device(load(self.backend), self.device)

    def prepare(self) -> None:
        """Import what an estimate needs, and check the device."""
        import lfgpu.pipelines.estimate  # noqa: F401

        self.check_device()

    def run(self, lf: LightField, *, quiet: bool, check_cameras: bool = True) -> DepthResult:
        """Estimate the map of the reference view, with a progress display."""
        from lfgpu.cli.console import progress
        from lfgpu.pipelines.estimate import estimate_depth

        with progress(self.config, quiet=quiet) as on_progress:
            return estimate_depth(lf, on_progress=on_progress, check_cameras=check_cameras, **self._options)

    def run_all(self, lf: LightField, *, quiet: bool) -> ViewsResult:
        """Estimate the maps of all views, with a progress display."""
        from lfgpu.cli.console import progress
        from lfgpu.pipelines.all_views import estimate_all_views

        with progress(self.config, quiet=quiet) as on_progress:
            options = {name: value for name, value in self._options.items() if name != "max_memory"}
            return estimate_all_views(lf, on_progress=on_progress, **options)

    @property
    def _options(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}
