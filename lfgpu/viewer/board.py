"""State that all tabs of a viewer share: contents, running estimate, stream. It knows nothing of the web."""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lfgpu.data import DepthResult, DisparityMap, LightField
from lfgpu.data.light_field_checks import named
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.io.reporting import heard_by
from lfgpu.viewer.contents import LIVE, Contents, Entry, opened, opened_all
from lfgpu.viewer.solving import Request, Solver

Switch = Callable[[bool], None]
"""Called with True to start something, with False to end it."""


@dataclass(frozen=True)
class Stream:
    """The facts about a stream; None is unknown."""

    rate: float | None = None  # frames per second
    latency: float | None = None  # seconds from a frame to its map
    dropped: int | None = None  # frames that were dropped so far
    paused: bool = False
    recording: bool = False


class Board:
    """The state of a viewer, whose pages open any path if `allow_open`. Methods may be called from any thread."""

    def __init__(self, *, allow_open: bool = False) -> None:
        self._lock = threading.RLock()
        self._contents = Contents()
        self._listeners: list[Callable[[], None]] = []
        self._given: tuple[Path, ...] = ()
        self._allow_open = allow_open
        self.newest: str | None = None
        """The map that came last; pages select it."""
        self.loading: tuple[str, float] | None = None
        """The picture that is being read or drawn, and since when (`perf_counter`); None if there is none."""
        self.stream = Stream()
        self.switches: dict[str, Switch] = {}
        """What pages may switch of a stream: "pause", "record"."""
        self.solver = Solver(lambda _: self.tell(), self._on_result)
        """Estimates for pages."""

    # --- listeners ---

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call `listener` after each change, from any thread. Returns what ends that."""
        with self._lock:
            self._listeners.append(listener)

        def end() -> None:
            with self._lock, suppress(ValueError):
                self._listeners.remove(listener)

        return end

    def tell(self) -> None:
        """Tell all listeners that something has changed."""
        with self._lock:
            listeners = tuple(self._listeners)
        for listener in listeners:
            try:
                listener()
            except Exception:  # one that fails must not keep the others from knowing
                logging.getLogger("lfgpu.viewer").exception("a listener failed")

    # --- contents ---

    @property
    def contents(self) -> Contents:
        """The contents that are shown now."""
        return self._contents

    def replace(self, contents: Contents, *, newest: str | None = None) -> None:
        """Show other contents; pages select the map `newest`."""
        with self._lock:
            self._contents, self.newest = contents, newest or self.newest
        self.tell()

    def show(
        self, lf: LightField, result: DepthResult | DisparityMap | None = None, *, name: str | None = None
    ) -> None:
        """Replace everything by another light field and a result of it. May be called from any thread."""
        contents = Contents(lf)
        if result is not None:
            contents = contents.with_entry(name or "result", Entry.of(result))
        self.replace(contents)

    def add(self, result: DepthResult | DisparityMap, *, name: str | None = None) -> str:
        """Add a result for comparison. May be called from any thread. Returns its name on the page."""
        with self._lock:
            return self._add(Entry.of(result, self._contents.frame), name or "result")

    def _add(self, entry: Entry, name: str) -> str:
        with self._lock:
            free = self._contents.free_name(name)
            self.replace(self._contents.with_entry(free, entry), newest=free)
        return free

    def load(self, paths: Sequence[str | os.PathLike[str]], **reading: Any) -> None:
        """Read files and show them; meanwhile pages say what is being read. `Viewer.of` describes the parameters."""
        files = [named(path) for path in paths]
        self._given = tuple(file.resolve() for file in files)
        with self._reading(", ".join(file.name for file in files)):
            contents = opened_all(files, **reading)
        self.replace(contents)

    def open(self, path: str | os.PathLike[str]) -> None:
        """Open a path: a light field replaces everything, a map is added. LightFieldError if it is neither."""
        file = named(path)
        with self._reading(file.name):
            contents = opened(file, self._contents)
        added = [name for name in contents.entries if name not in self._contents.entries]
        self.replace(contents, newest=added[-1] if added else None)

    def turn(self, number: int) -> None:
        """Show another frame of the film. LightFieldError if there is none, or it cannot be read."""
        with self._lock:
            self.replace(self._contents.turned(number))

    def open_from_page(self, path: str | os.PathLike[str]) -> None:
        """Open a path for a page: LightFieldError also for what the page may not open."""
        where = Path(path).resolve()
        if not self._allow_open and not any(where.is_relative_to(given) for given in self._given):
            raise LightFieldError(
                f"{path} is not among the paths that lfgpu view was given; to open any from the page, start it with "
                "--allow-open."
            )
        self.open(path)

    @contextmanager
    def working(self, what: str) -> Iterator[Callable[[str], None]]:
        """Tell pages what is being done; returns what tells them a step of it."""
        begin = perf_counter()

        def say(step: str) -> None:
            self.loading = (f"{what}{f': {step}' if step else ''}", begin)
            self.tell()

        say("")
        try:
            yield say
        finally:
            self.loading = None
            self.tell()

    @contextmanager
    def _reading(self, what: str) -> Iterator[None]:
        with self.working(f"Reading {what}") as say, heard_by(say):
            yield

    # --- estimates ---

    def _on_result(self, request: Request, result: DepthResult) -> None:
        lf = self._contents.lf
        if lf is not None and lf.size == result.disparity.shape:  # another light field may have been opened meanwhile
            with suppress(LfgpuError):
                self._add(Entry.of(result, request.frame), request.name)

    # --- streams ---

    def update(
        self,
        disparity: ArrayLike,
        confidence: ArrayLike | None = None,
        *,
        views: ArrayLike | None = None,
        rate: float | None = None,
        latency: float | None = None,
        dropped: int | None = None,
    ) -> None:
        """Show the newest frame of a stream. May be called from any thread; returns at once.

        Parameters
        ----------
        disparity
            [y, x], pixels per view step; copied, so that its buffer may be written to again.
        confidence
            [y, x], 0 to 1; None if there is none.
        views
            The views that it belongs to, as those of the light field that is shown; None leaves these. The ground truth
            and its scores go with the views that they belong to.
        rate
            Frames per second. Default None: not shown.
        latency
            Seconds from the frame to its map. Default None: not shown.
        dropped
            Frames that were dropped so far. Default None: not shown.

        Raises
        ------
        LightFieldError
            If sizes are not those of what is shown.
        """
        entry = Entry(
            DisparityMap(
                np.array(disparity, np.float32), None if confidence is None else np.array(confidence, np.float32)
            )
        )
        if entry.disparity.ndim != 2:
            raise LightFieldError(f"disparity must be [y, x], found shape {entry.disparity.shape}.")
        if entry.confidence is not None and entry.confidence.shape != entry.disparity.shape:
            raise LightFieldError(
                f"confidence must be {entry.disparity.shape} as the disparity, found {entry.confidence.shape}."
            )
        frame = None if views is None else np.array(views)
        with self._lock:
            before, self._contents = self._contents, self._contents.with_frame(entry, frame)
            self.newest = self.newest if LIVE in before.entries else LIVE
            self.stream = replace(self.stream, rate=rate, latency=latency, dropped=dropped)
        self.tell()

    def offer(self, *, pause: Switch | None = None, record: Switch | None = None) -> None:
        """Offer buttons for a stream on all pages: `pause` and `record` take True when switched on, else False."""
        offered = {"pause": pause, "record": record}
        self.switches = {name: switch for name, switch in offered.items() if switch is not None}
        self.tell()

    def switch(self, name: str, on: bool) -> None:
        """Switch "pause" or "record" of the stream, as a page asks. LightFieldError if that is not offered."""
        if name not in self.switches:
            raise LightFieldError(f"this stream has no switch {name!r}.")
        self.switches[name](on)
        self.stream = replace(self.stream, paused=on) if name == "pause" else replace(self.stream, recording=on)
        self.tell()
