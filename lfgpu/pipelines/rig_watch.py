"""`RigWatch`: looks at the cameras of a stream now and then; tones that follow, and a sentence when they moved."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from lfgpu._backends import DEFAULT, open_device
from lfgpu.cameras.looking import FEWEST, Look, look
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.pipelines.stream import DepthStream

_LONGEST_WAIT = 5.0  # seconds for a frame
_LARGEST = 1.25  # factor by which a gain found is believed to be off at most
_LARGEST_OFFSET = 0.1  # intensity


class RigWatch:
    """Watch over the cameras of a stream, from a thread of its own.

        with lfgpu.DepthStream(rectifier.pictures(frame), rectifier=rectifier) as stream:
            with lfgpu.calibration.RigWatch(stream, on_finding=print):
                ...

    Each look takes the views of one frame and compares them by their map (`lfgpu.explain`, quickly). If the stream has
    a rectifier, gains and offsets of its cameras slowly follow the measured ones. A camera is said to have moved when
    two looks in a row find it.

    Parameters
    ----------
    stream
        The stream.
    every
        Seconds from one look to the next, > 0; default 10. None looks only when `look` is called.
    rate
        Share of a difference in brightness that a look corrects, 0 to 1; default 0.3.
    on_finding
        Called with the sentences when cameras are found to have moved, once until they fit again; from the thread of
        the watch. Its exceptions are ignored. Default None.

    Raises
    ------
    LightFieldError
        If a number is out of its range.
    """

    def __init__(
        self,
        stream: DepthStream,
        *,
        every: float | None = 10.0,
        rate: float = 0.3,
        on_finding: Callable[[tuple[str, ...]], None] | None = None,
    ) -> None:
        if not (every is None or 0 < every < threading.TIMEOUT_MAX) or not 0 <= rate <= 1:
            raise LightFieldError(
                f"every must be a number of seconds > 0 and rate a share from 0 to 1, not {every} and {rate}."
            )
        self._stream, self._rate, self._on_finding = stream, rate, on_finding
        self.findings: tuple[str, ...] = ()
        """Known faults of the places and directions of the cameras, one sentence each; empty if there is none."""
        self.looks = 0
        """Number of frames that were looked at."""
        self._suspected = False
        self._turn, self._over = threading.Lock(), threading.Event()
        self._thread: threading.Thread | None = None
        if every is not None:
            self._thread = threading.Thread(target=self._watch, args=(every,), name="lfgpu-watch", daemon=True)
            self._thread.start()

    def look(self, *, timeout: float | None = _LONGEST_WAIT) -> tuple[str, ...]:
        """Look at the next frame now; waits for it `timeout` seconds at most (None: no limit). Returns `findings`."""
        with self._turn:
            shown = self._stream.snapshot(timeout=timeout)
            if shown is None:
                return self.findings
            lf, result = shown
            try:
                found = look(lf, result.numpy(), open_device(DEFAULT, self._stream.device), budget="quick")
            except LfgpuError:  # the frame failed, which its own result says
                return self.findings
            if found is None or found.points < FEWEST:  # too little texture to tell
                return self.findings
            self.looks += 1
            self._judge(found)
            if self._stream.rectifier is not None and self._rate > 0:
                self._equalise(found)
            return self.findings

    def close(self) -> None:
        """End the thread; the stream goes on."""
        self._over.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join()

    def __enter__(self) -> RigWatch:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- steps ---

    def _watch(self, every: float) -> None:
        while not self._over.wait(every):
            self.look()

    def _judge(self, found: Look) -> None:
        moved = found.moved if self._suspected else ()
        self._suspected = bool(found.moved)
        new = bool(moved) and not self.findings
        self.findings = moved
        if new and self._on_finding is not None:
            with suppress(Exception):  # the watch must not end for what others do with its findings
                self._on_finding(moved)

    def _equalise(self, found: Look) -> None:
        """Change the tones of the rectifier such that a share of the differences in brightness is gone."""
        assert self._stream.rectifier is not None
        tones = self._stream.rectifier.tones.copy()
        gain = np.clip(found.gain, 1 / _LARGEST, _LARGEST) ** self._rate
        offset = np.clip(found.offset, -_LARGEST_OFFSET, _LARGEST_OFFSET) * self._rate
        used = list(self._stream.used_views)
        # A view shows g t + o where its picture is G (g t + o) + O.
        tones[used, 1] += tones[used, 0] * offset
        tones[used, 0] *= gain
        tones[used, 2] *= gain
        self._stream.set_tones(tones)
