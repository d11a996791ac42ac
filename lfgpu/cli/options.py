"""Options that several commands share, alone or in groups, and the estimate that they ask for.

A group is a dataclass whose fields are options. A command takes the group as one keyword. `with_groups` puts the
options of the group in its place on the command line, and makes the dataclass of the values that were given.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, get_type_hints

import typer

from lfgpu._backends import DEFAULT, BackendName, backend_named
from lfgpu.cli import values

if TYPE_CHECKING:
    from lfgpu.config import Config
    from lfgpu.data import DepthResult, LightField, ViewsResult


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
            return estimate_depth(lf, on_progress=on_progress, check_cameras=check_cameras, **vars(self))

    def run_all(self, lf: LightField, *, quiet: bool) -> ViewsResult:
        """Estimate the maps of all views, with a progress display."""
        from lfgpu.cli.console import progress
        from lfgpu.pipelines.all_views import estimate_all_views

        with progress(self.config, quiet=quiet) as on_progress:
            options = {name: value for name, value in vars(self).items() if name != "max_memory"}
            return estimate_all_views(lf, on_progress=on_progress, **options)


Source = Annotated[Path, typer.Argument(metavar="INPUT", help="Light field: usually a folder of views.")]

OutFolder = Annotated[
    Path, typer.Option("-o", "--out", metavar="FOLDER", help="Folder for the outputs; created if missing.")
]


def preset_option(listed: str, usual: str | None = None) -> Any:
    """Make the option --preset, whose help ends with a list; `usual` is the preset without it and without --weights."""
    told = True if usual is None else f"{usual}, or learned with --weights"
    return typer.Option("--preset", metavar="NAME", help=f"Parameters to start from{listed}.", show_default=told)


Preset = Annotated[str, preset_option(". {presets}")]

ReferenceView = Annotated[
    str | None,
    typer.Option(
        "--reference-view",
        metavar="ROW,COL",
        help="Reference view: the view to estimate, counted from 0.",
        show_default="the centre",
    ),
]

DisparityRange = Annotated[
    str | None,
    typer.Option(
        "--disparity-range",
        metavar="LOW,HIGH",
        help="Smallest and largest disparity, pixels per view step; larger is nearer.",
        show_default="found",
    ),
]

Threads = Annotated[
    int | None,
    typer.Option("--threads", metavar="N", help="Largest number of CPU threads.", show_default="one per core"),
]

Deterministic = Annotated[
    bool,
    typer.Option("--deterministic", help="Refuse backends whose results are not bit-identical from run to run."),
]

Device = Annotated[
    str | None,
    typer.Option(
        "--device",
        metavar="DEVICE",
        help="cpu, cuda, cuda:1, vulkan or metal.",
        show_default="the first GPU, else the CPU",
    ),
]

Cold = Annotated[bool, typer.Option("--cold", help="Estimate each frame independently, without the temporal prior.")]

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


def _is_given(value: object) -> bool:
    return value is not None and value is not False and value != ""  # 0 is: the first time


@dataclass(frozen=True)
class Reading:
    """Options of `lfgpu.read`."""

    format_name: Annotated[
        str | None,
        typer.Option("--format", metavar="NAME", help="Format of the input: {formats}.", show_default="recognised"),
    ] = None
    grid: Annotated[
        str | None,
        typer.Option(
            metavar="ROWSxCOLUMNS", help="Rows and columns of the grid of views.", show_default="found from the input"
        ),
    ] = None
    every: Annotated[
        int | None, typer.Option(metavar="N", help="Use every N-th image or frame as a view.", show_default="all")
    ] = None
    order: Annotated[
        str | None,
        typer.Option(
            metavar="ORDER",
            help="Order of numbered views in the grid: row-major, column-major, serpentine, serpentine-columns.",
            show_default="row-major",
        ),
    ] = None
    names: Annotated[
        str | None,
        typer.Option(
            "--pattern",
            metavar="PATTERN",
            help="Meaning of numbers in names of images: cam{u}_frame{t}.png; u column, v row, n camera, t time.",
            show_default="found",
        ),
    ] = None
    frame: Annotated[
        int | None,
        typer.Option(metavar="N", help="Time to read, from 0, where cameras have several.", show_default="the first"),
    ] = None
    axes: Annotated[
        str | None,
        typer.Option(metavar="ORDER", help="Order of the axes of an array, such as yxvuc.", show_default="found"),
    ] = None
    unit: Annotated[
        str | None,
        typer.Option(metavar="UNIT", help="Unit of lengths without one: mm, cm or m.", show_default="m"),
    ] = None
    transpose: Annotated[bool, typer.Option("--transpose", help="Swap rows and columns of cameras.")] = False
    flip: Annotated[
        str, typer.Option(metavar="AXES", help="Reverse the order of the columns (u), the rows (v) or both (uv).")
    ] = ""

    def options(self) -> dict[str, Any]:
        """Return the options that were given, as keywords of `lfgpu.read`; LightFieldError if --grid is no pair."""
        found = dict(vars(self))
        found |= {"format": found.pop("format_name"), "pattern": found.pop("names")}
        found["grid"] = values.parse_size("--grid", self.grid, "ROWSxCOLUMNS such as 9x9")
        return {name: value for name, value in found.items() if _is_given(value)}

    def words(self) -> list[str]:
        """Return the options that were given as words of a command line, as `lfgpu view` takes them."""
        names = {"format_name": "format", "names": "pattern"}
        found = [(f"--{names.get(one.name, one.name)}", getattr(self, one.name)) for one in fields(Reading)]
        given = [(name, value) for name, value in found if _is_given(value)]
        return [word for name, value in given for word in ([name] if value is True else [name, str(value)])]


@dataclass(frozen=True)
class ReadingIncomplete(Reading):
    """Options of `lfgpu.read` where missing views are an error unless they are allowed."""

    allow_missing: Annotated[bool, typer.Option("--allow-missing", help="Accept a grid with missing views.")] = False


@dataclass(frozen=True)
class Views:
    """Options that choose the reference view and the views that are used."""

    reference_view: ReferenceView = None
    pattern: Annotated[
        str, typer.Option("--views", metavar="PATTERN", help="Views to use: full, star, cross, row or column.")
    ] = "full"

    def place(self) -> tuple[float, float] | None:
        """Return (row, column) of the reference view, None if it was not given, and check the pattern."""
        values.check_pattern("--views", self.pattern)
        return values.parse_place("--reference-view", self.reference_view)

    def of(self, lf: LightField) -> LightField:
        """Return the light field with this reference view, and with these views only."""
        if (place := self.place()) is not None:
            lf = lf.with_reference(lf.index_of(*place))
        return lf if self.pattern == "full" else lf.subset(self.pattern)


@dataclass(frozen=True)
class Parameters:
    """Options that choose the parameters of a method."""

    usual: ClassVar[str | None] = None  # preset without --preset and --weights; None for that of lfgpu

    preset: Annotated[str | None, preset_option(". {presets}", "surest")] = None
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Weights that `lfgpu train` wrote, for the network of the presets learned and surest.",
            show_default="those of lfgpu",
        ),
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="STAGE.PARAMETER=VALUE",
            help="Change one parameter; may be repeated. `lfgpu parameters` lists them.",
        ),
    ] = None

    def config(self) -> Config:
        """Return the parameters; LightFieldError if one is wrong or unknown."""
        preset = self.usual if self.preset is None and self.weights is None else self.preset
        return values.configured(preset, self.settings or (), self.weights)


@dataclass(frozen=True)
class Computing:
    """Options of an estimate beside its parameters: what is searched, and what computes."""

    disparity_range: DisparityRange = None
    backend: Annotated[str, typer.Option(metavar="NAME", help="Backend that computes: {backends}.")] = DEFAULT
    device: Device = None
    threads: Threads = None

    def estimation(self, config: Config, *, check: bool = True, **more: Any) -> Estimation:
        """Return the estimate that is asked for, and set the threads of the CPU.

        LfgpuError if an option is wrong or, with `check`, if the backend or the device is missing.
        """
        bounds = values.parse_range("--disparity-range", self.disparity_range)
        found = Estimation(config, bounds, backend_named(self.backend), self.device, **more)
        values.use_threads("--threads", self.threads)
        if check:
            found.check_device()
        return found


def with_groups(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the options of its groups in place of the groups."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    options = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name not in groups:
            options.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY, annotation=hints[name]))
            continue
        own = get_type_hints(groups[name], include_extras=True)
        options += [
            inspect.Parameter(
                field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=own[field.name]
            )
            for field in fields(groups[name])
        ]

    @wraps(command)
    def run(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        command(**given)

    run.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    run.__annotations__ = {option.name: option.annotation for option in options}
    return run
