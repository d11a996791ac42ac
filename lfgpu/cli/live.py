"""`lfgpu live`: depth of a stream of frames."""

from __future__ import annotations

import json
import math
import signal
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lfgpu.cli import values
from lfgpu.cli.options import Cold, Device, Parameters, Quiet, ReadingIncomplete, Threads, preset_option
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.threads import on_signal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from lfgpu.data import LightField
    from lfgpu.pipelines.sources import Frames
    from lfgpu.pipelines.stream import DepthStream
    from lfgpu.pipelines.stream_result import StreamResult

_REFRESH = 0.25  # seconds
_SHOWN_AGAIN = 0.1  # seconds between two frames on the page


@dataclass(frozen=True)
class _Parameters(Parameters):
    """Options that choose the parameters of a method that takes streams."""

    usual = "accurate"

    preset: Annotated[str | None, preset_option(": {live presets}", "accurate")] = None


@dataclass(frozen=True)
class _Reading(ReadingIncomplete):
    """Options of the cameras, and of the files in a folder."""

    grid: Annotated[
        str | None,
        typer.Option(
            metavar="ROWSxCOLUMNS",
            help="Rows and columns of the cameras, or of the views in each frame of a video, row by row.",
            show_default="a row; 7x7 for a scene; found in a folder",
        ),
    ] = None
    frame: Annotated[int | None, typer.Option(hidden=True)] = None  # a stream has all; whoever gives one is told


def live(
    source: Annotated[
        str,
        typer.Argument(metavar="SOURCE", help="{sources}."),
    ],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="FOLDER", help="Folder that keeps each map as it comes, and a log."),
    ] = None,
    *,
    parameters: _Parameters,
    disparity_range: Annotated[
        str | None,
        typer.Option(
            metavar="LOW,HIGH",
            help="Smallest and largest disparity, pixels per view step.",
            show_default="found on the first frame",
        ),
    ] = None,
    policy: Annotated[
        str | None,
        typer.Option(
            metavar="NAME[:N]",
            help="Treatment of frames that come too fast: latest (only the newest one waits), block (the source "
            "waits) or queue:N (up to N frames wait).",
            show_default="latest for cameras, rings, growing folders and functions, block for the rest",
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            metavar="MS", help="Limit of the device time per frame, milliseconds; the work is reduced to fit."
        ),
    ] = None,
    cold: Cold = False,
    max_fps: Annotated[
        float | None, typer.Option("--max-fps", metavar="RATE", help="Largest number of frames per second.")
    ] = None,
    frames: Annotated[int | None, typer.Option(metavar="N", help="Stop after N frames.", min=1)] = None,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Show frames and maps in the browser, about ten a second, with a button that pauses the stream; with "
            "--rectify the raw frames.",
        ),
    ] = False,
    recording: Annotated[
        Path | None,
        typer.Option(
            "--record",
            metavar="FOLDER",
            help="Folder in which each frame is kept before it is estimated, to be played again as SOURCE; the page of "
            "--view has a button that stops and resumes it.",
        ),
    ] = None,
    reading: _Reading,
    like: Annotated[
        Path | None,
        typer.Option(
            metavar="LIGHTFIELD",
            help="Light field of the same cameras that gives their positions, reference view and geometry.",
        ),
    ] = None,
    size: Annotated[
        str | None,
        typer.Option(
            metavar="HEIGHTxWIDTH",
            help="Size of the views of a synthetic scene, pixels.",
            show_default="192x256",
        ),
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="Noise of the views of a synthetic scene: standard deviation, intensities 0 to 1.",
            show_default="0.005",
        ),
    ] = None,
    rectify: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Output of `lfgpu rectify` for these cameras. Frames are raw pictures, rectified on the device; "
            "the cameras are watched.",
        ),
    ] = None,
    device: Device = None,
    threads: Threads = None,
    quiet: Quiet = False,
) -> None:
    """Estimate the disparity of each frame of a stream. Ctrl-C ends it, and so does SIGTERM.

    With -o each map is written as soon as it is computed (disparity_000000.pfm, confidence_000000.pfm). At the end
    live.json records what happened to every frame. With --rectify the gains of the cameras are kept up to date, and a
    message says if cameras have moved.
    """
    from contextlib import nullcontext, suppress

    from lfgpu import calibration
    from lfgpu.io import check_writable, read
    from lfgpu.methods.temporal_prior import TemporalPrior
    from lfgpu.pipelines.sources import Options, feed, open_source, recorded
    from lfgpu.pipelines.stream import DepthStream

    for folder in (out, recording):
        if folder is not None:
            check_writable(folder, source=Path(source) if Path(source).is_dir() else None)
    if recording is not None and next(recording.glob("frame_*"), None) is not None:
        raise LightFieldError(f"{recording} holds frames already, which would mix with new ones; name a new folder.")
    for option, value in (("--max-fps", max_fps), ("--budget", budget)):
        if value is not None and not (value > 0 and math.isfinite(value)):
            raise typer.BadParameter("it must be a number above 0.", param_hint=option)
    if like is not None and rectify is not None:
        raise typer.BadParameter("leave it out: what --rectify names says where the cameras are.", param_hint="--like")
    config = parameters.config()
    bounds = values.parse_range("--disparity-range", disparity_range)
    chosen = values.parse_policy("--policy", policy)
    values.use_threads("--threads", threads)
    rectifier = None if rectify is None else calibration.read_rectifier(rectify)
    made = {"size": values.parse_size("--size", size, "HEIGHTxWIDTH such as 192x256"), "noise": noise}
    read_with = reading.options()
    options = Options(
        grid=read_with.pop("grid", None),
        like=None if like is None else read(like),
        reading=read_with,
        scene={name: value for name, value in made.items() if value is not None},
        most=frames,
        rectifier=rectifier,
        say=(lambda _: None) if quiet else _say,
    )
    opened = open_source(source, options)
    first, coming = opened.first, opened.frames
    way, waiting = chosen or ("latest" if opened.is_live else "block", None)
    record = Record(out)
    coming = record.seen(coming, first)
    with (
        View(first if view else None, records=recording is not None) as page,
        DepthStream(
            first,
            config=config,
            disparity_range=bounds,
            device=device,
            prior=None if cold else TemporalPrior(),
            policy=way,
            waiting=waiting,
            budget_ms=budget,
            rectifier=rectifier,
        ) as stream,
    ):

        def done(result: StreamResult) -> None:
            record.add(result)
            look()
            page.show(stream, result)

        if recording is not None:
            coming = recorded(coming, first, recording, wanted=lambda: page.records)
        watch = nullcontext() if rectifier is None else calibration.RigWatch(stream, on_finding=record.moved)
        with on_signal(signal.SIGTERM, signal.default_int_handler), watch, _displayed(stream, quiet=quiet) as look:
            try:
                feed(
                    stream,
                    coming,
                    max_fps=max_fps,
                    most=frames,
                    hold=lambda: page.pauses,
                    tag=page.kept,
                    on_done=done,
                )
            except KeyboardInterrupt:
                stream.close(finish=False)
            except BaseException:
                with suppress(LfgpuError):  # it is the first error that is told
                    record.finish(stream, stream.stats())
                raise
        stats = stream.stats()
    record.finish(stream, stats)
    if not quiet:
        _show(stream, stats, record, recording)


class Record:
    """The log of all frames; with a folder, it also writes the maps."""

    def __init__(self, out: Path | None) -> None:
        self.out, self._frames, self.failed = out, [], []  # type: ignore[var-annotated]
        self.findings: tuple[str, ...] = ()
        self._references: list[str | None] = []
        self._holds_earlier = out is not None
        if out is not None:
            out.mkdir(parents=True, exist_ok=True)

    def seen(self, frames: Frames, first: LightField) -> Frames:
        """Yield the same frames, and keep for the log what tells their reference views apart."""
        from lfgpu.io.live_maps import fingerprint
        from lfgpu.pipelines.sources.recording import reference_view

        for frame in frames:
            if self.out is not None:
                view = reference_view(frame, first)
                self._references.append(None if view is None else fingerprint(view))
            yield frame

    def add(self, result: StreamResult) -> None:
        """Record a frame that has a result, failed or was dropped."""
        from lfgpu.io.live_maps import write_live_map

        if result.error is not None and not result.dropped:
            self.failed.append((result.index, str(result.error)))
        if self.out is None:
            return
        frame = {"frame": result.index, "reference": self._references[result.index]}
        if result.error is not None:
            self._frames.append({**frame, "error": str(result.error)})
            return
        self._remove_earlier(self.out)
        write_live_map(self.out, result.index, result.numpy(), result.confidence())
        self._frames.append(
            {
                **frame,
                "cold": result.cold,
                "cut": result.cut,
                "steps": result.steps,
                "views": int(result.valid.sum()),
                "latency_ms": round(result.latency * 1000, 3),
                "work_ms": round(result.work * 1000, 3),
            }
        )

    def moved(self, findings: tuple[str, ...]) -> None:
        """Record that cameras have moved, and say it."""
        self.findings = findings
        for sentence in findings:
            typer.echo(f"The cameras have moved: {sentence}", err=True)

    def _remove_earlier(self, out: Path) -> None:
        """Remove the maps and the log of an earlier run, once; a run that does not even start leaves them."""
        from lfgpu.io.live_maps import remove_live_maps

        if self._holds_earlier:
            remove_live_maps(out)
            self._holds_earlier = False

    def finish(self, stream: DepthStream, stats: dict[str, Any]) -> None:
        """Write the log."""
        if self.out is None:
            return
        from dataclasses import asdict

        from lfgpu.io import atomic_write
        from lfgpu.io.about import CONVENTION
        from lfgpu.io.live_maps import LOG

        about = {
            "convention": CONVENTION,
            "device": stream.device,
            "disparity_range": list(stream.bounds),
            "config": asdict(stream.config),
            "warnings": list(stream.warnings),
            "stats": {name: None if math.isnan(value) else value for name, value in stats.items()},
            "cameras": list(self.findings),
            "frames": self._frames,
        }
        self._remove_earlier(self.out)
        with atomic_write(self.out / LOG) as temporary:
            temporary.write_text(json.dumps(about, indent=1, allow_nan=False), encoding="utf-8")


class View:
    """The page in the browser that shows frames and maps, and what is switched there.

    Without a first frame there is none. `records` says whether frames are recorded; if they are, that can be switched.
    """

    def __init__(self, first: LightField | None, *, records: bool) -> None:
        from functools import partial

        self._viewer, self._next = None, 0.0
        self.pauses, self.records = False, records
        if first is not None:
            from lfgpu.viewer import Viewer

            self._viewer = Viewer(first)
            record = partial(setattr, self, "records") if records else None
            self._viewer.offer(pause=partial(setattr, self, "pauses"), record=record)
            if records:
                self._viewer.switch("record", True)
            _say(f"Open {self._viewer.url} with a browser on this machine.")

    def __enter__(self) -> View:
        return self

    def __exit__(self, *_: object) -> None:
        if self._viewer is not None:
            self._viewer.close()

    def kept(self, _: int, views: Any) -> Any:
        """Copy the views of a frame that will be shown; None for the others."""
        if self._viewer is None or time.monotonic() < self._next:
            return None
        self._next = time.monotonic() + _SHOWN_AGAIN
        from lfgpu.data.interop import on_host

        try:
            return on_host("views", views).copy()
        except LightFieldError:  # the stream says what is wrong with it
            return None

    def show(self, stream: DepthStream, result: StreamResult) -> None:
        """Show a result whose frame was kept, and how the stream fares."""
        if self._viewer is not None and result.tag is not None and result.error is None:
            shown = self._viewer.contents.lf
            views = result.tag if shown is None else result.tag.reshape(shown.views.shape)
            stats = stream.stats()
            self._viewer.update(
                result.numpy(),
                result.confidence(),
                views=views,
                rate=stats["frames_per_second"],
                latency=result.latency,
                dropped=stats["frames_dropped"],
            )


@contextmanager
def _displayed(stream: DepthStream, *, quiet: bool) -> Iterator[Callable[[], None]]:
    """Show rate and latency on a terminal while the block runs. Yields what shows the newest, if it is time."""
    from lfgpu.cli.console import waiting

    due = time.monotonic()

    def look() -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + _REFRESH
            say("\n".join(f"{label:<10}{text}" for label, text in facts(stream.stats())))

    with waiting("waiting for the first map", quiet=quiet) as say:
        yield look


def facts(stats: dict[str, Any]) -> list[tuple[str, str]]:
    """Describe the statistics of a stream for people, as pairs of label and text."""

    def times(what: str) -> str:
        return " / ".join(f"{stats[f'{what}_p{quantile}_ms']:.1f}" for quantile in (50, 95, 99))

    frames = f"{stats['frames_done']} of {stats['frames_pushed']}"
    for name, what in (("dropped", "dropped"), ("failed", "failed"), ("cold", "cold")):
        frames += f", {stats[f'frames_{name}']} {what}"
    if stats["frames_with_missing_views"]:
        frames += f", {stats['frames_with_missing_views']} without some views"
    lines = [("maps", frames), ("rate", f"{stats['frames_per_second']:.1f} / s")]
    if stats["frames_done"]:
        lines += [
            ("latency", f"{times('latency')} ms (median, 95 %, 99 %)"),
            ("work", f"{times('work')} ms of the device"),
        ]
    return lines


def _say(sentence: str) -> None:
    typer.echo(sentence, err=True)


def _show(stream: DepthStream, stats: dict[str, Any], record: Record, recording: Path | None) -> None:
    from lfgpu.cli.console import lines, output, remark
    from lfgpu.cli.summary import show_next

    console = output()
    low, high = stream.bounds
    lines(console, [("device", stream.device), ("range", f"{low:.3g} to {high:.3g} px per view step")])
    lines(console, facts(stats))
    for warning in stream.warnings:
        remark(console, warning)
    for index, sentence in record.failed[:3]:
        remark(console, f"Frame {index}: {sentence}")
    if len(record.failed) > 3:
        remark(console, f"... and {len(record.failed) - 3} more frames failed.")
    if record.out is not None:
        lines(console, [("recorded", str(record.out))])
        if recording is not None:
            show_next(console, ("lfgpu", "view", recording, record.out))
