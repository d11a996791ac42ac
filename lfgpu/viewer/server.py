"""The viewer: a page in the browser that shows a light field and its maps, also while they change."""

from __future__ import annotations

import os
import re
import secrets
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lfgpu.data.lightfield import LightField
from lfgpu.data.result import DepthResult, DisparityMap
from lfgpu.errors import LfgpuError, LightFieldError
from lfgpu.io.extras import how_to_install
from lfgpu.viewer.contents import Contents, Entry, opened, opened_all
from lfgpu.viewer.solving import Progress, Request, Solver

HOST = "127.0.0.1"
"""The page is reachable from this machine only."""

LIVE = "live"
"""The name on the page of the map from `Viewer.update`."""

_OWN_PAGES = re.compile(r"http://(127\.0\.0\.1|localhost)(:\d+)?")
_BRAND = (28, 126, 214)


class Viewer:
    """A page in the browser, on this machine only, that shows a light field and its disparity maps.

        viewer = lfgpu.Viewer(lf, result)
        viewer.url                              # http://127.0.0.1:8080/…/, with a token that nobody else knows
        viewer.update(disparity, confidence)    # from any thread, as often as there is a new one
        viewer.close()

    Every tab of the browser has its own sliders; all show the same light field and maps. A tab draws what is asked for
    last and skips what came before, so neither many frames nor a slow browser hold up who calls `update`.

    Parameters
    ----------
    lf, result
        What to show first; None for nothing yet.
    port
        Of 127.0.0.1; the next free one if it is taken. 0 takes any. Default 8080.
    allow_open
        Whether pages may open any path that its owner can read; else those only that `of` was given, and what lies in
        them. Default False.

    Raises
    ------
    LightFieldError
        If viser is not installed, or the result is not of the light field's size.
    """

    def __init__(
        self,
        lf: LightField | None = None,
        result: DepthResult | DisparityMap | None = None,
        *,
        port: int = 8080,
        allow_open: bool = False,
    ) -> None:
        try:
            import viser
        except ImportError:
            raise LightFieldError(f"the viewer needs viser; {how_to_install('viewer')}.") from None
        from lfgpu.viewer.session import Session

        self._lock = threading.RLock()
        self._contents = Contents()
        self._sessions: dict[int, Session] = {}
        self._closed = threading.Event()
        self._allow_open = allow_open
        self._given: tuple[Path, ...] = ()
        self._token = secrets.token_urlsafe(24)
        self.solver = Solver(self._on_progress, self._on_result)
        """What estimates for the page."""
        with _guarded(self._token), _silent():
            self._server = viser.ViserServer(host=HOST, port=port, verbose=False)
        self._server.request_share_url = _refuse_to_share  # type: ignore[method-assign]  # pages can ask for it
        self._server.gui.configure_theme(show_logo=False, show_share_button=False, brand_color=_BRAND)
        self._server.gui.set_panel_label("lfgpu")
        self._server.scene.set_up_direction("-y")
        if lf is not None:
            self.show(lf, result)
        elif result is not None:
            self.add(result)
        self._server.on_client_connect(self._connect)
        self._server.on_client_disconnect(self._disconnect)

    @classmethod
    def of(
        cls, paths: Sequence[str | os.PathLike[str]], *, port: int = 8080, allow_open: bool = False, **reading: Any
    ) -> Viewer:
        """A viewer of files: at most one light field, and maps of it.

        Parameters
        ----------
        paths
            The light field, map files, and folders that `lfgpu depth` wrote, in any order.
        port
            As for `Viewer`.
        allow_open
            Whether the page may open any path; default False: only these paths and what lies in them.
        reading
            Options of `lfgpu.read`. If there are any, the first path is read as the light field.

        Raises
        ------
        LightFieldError
            If a path is missing, or is neither a light field nor a map; or if the maps are of another size.
        """
        contents = opened_all([Path(path) for path in paths], **reading)
        viewer = cls(port=port, allow_open=allow_open)
        viewer._given = tuple(Path(path).resolve() for path in paths)
        viewer.replace(contents)
        return viewer

    def __repr__(self) -> str:
        contents = self._contents
        shown = "nothing" if contents.lf is None else repr(contents.lf.name)
        maps = f", maps {', '.join(contents.entries)}" if contents.entries else ""
        return f"<Viewer {'closed' if self._closed.is_set() else f'at {self.url}'}: {shown}{maps}>"

    @property
    def url(self) -> str:
        """Where the page is; whoever knows it can use the page."""
        return f"http://{HOST}:{self._server.get_port()}/{self._token}/"

    @property
    def contents(self) -> Contents:
        """What is shown now."""
        return self._contents

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
            free = self._contents.free_name(name or "result")
            self.replace(self._contents.with_entry(free, Entry.of(result)), newest=free)
        return free

    def open(self, path: str | os.PathLike[str]) -> None:
        """Open a path: a light field replaces everything, a map is added. LightFieldError if it is neither."""
        contents = opened(Path(path), self._contents)
        added = [name for name in contents.entries if name not in self._contents.entries]
        self.replace(contents, newest=added[-1] if added else None)

    def open_from_page(self, path: str | os.PathLike[str]) -> None:
        """The same for a page: LightFieldError also for what it may not open."""
        where = Path(path).resolve()
        if not self._allow_open and not any(where.is_relative_to(given) for given in self._given):
            raise LightFieldError(
                f"{path} is not among the paths that lfgpu view was given; to open any from the page, start it with "
                "--allow-open."
            )
        self.open(path)

    def update(
        self, disparity: ArrayLike, confidence: ArrayLike | None = None, *, views: ArrayLike | None = None
    ) -> None:
        """Show the newest frame of a stream. May be called from any thread; returns at once.

        Parameters
        ----------
        disparity
            [y, x], pixels per view step; copied, so that its buffer may be written to again.
        confidence
            [y, x], 0 to 1; None if there is none.
        views
            The views that it belongs to, as those of the light field that is shown; None leaves these.

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
        with self._lock:
            contents = self._contents
            is_new = LIVE not in contents.entries
            if views is not None and contents.lf is not None:
                frame = np.array(views)
                if frame.shape != contents.lf.views.shape or frame.dtype != contents.lf.views.dtype:
                    raise LightFieldError(
                        f"views must be {contents.lf.views.dtype} {contents.lf.views.shape} as those that are shown, "
                        f"found {frame.dtype} {frame.shape}."
                    )
                contents = replace(contents, lf=replace(contents.lf, views=frame))
            self._contents = contents.with_entry(LIVE, entry)
        for session in self._all_sessions():
            session.new_contents(LIVE if is_new else None, live=True, views=views is not None)

    def replace(self, contents: Contents, *, newest: str | None = None) -> None:
        """Show other contents; every tab selects the map `newest`."""
        with self._lock:
            other = contents.lf is not self._contents.lf or contents.size != self._contents.size
            self._contents = contents
        for session in self._all_sessions():
            if other:
                session.rebuild()
            else:
                session.new_contents(newest)

    def close(self) -> None:
        """Stop the solver, inform all tabs and free the port."""
        if self._closed.is_set():
            return
        self._closed.set()
        self.solver.close()
        for session in self._all_sessions():
            session.close()
        with _silent():
            self._server.stop()

    def wait(self) -> None:
        """Wait until `close` is called from another thread."""
        while not self._closed.wait(0.5):  # so that Ctrl-C is heard everywhere
            pass

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # --- what happens on the page ---

    def _connect(self, client: Any) -> None:
        from lfgpu.viewer.session import Session

        session = Session(self, client)
        with self._lock:
            self._sessions[client.client_id] = session
        session.start()

    def _disconnect(self, client: Any) -> None:
        with self._lock:
            session = self._sessions.pop(client.client_id, None)
        if session is not None:
            session.close()

    def _all_sessions(self) -> list[Any]:
        with self._lock:
            return list(self._sessions.values())

    def _on_progress(self, progress: Progress) -> None:
        for session in self._all_sessions():
            session.show_progress(progress)

    def _on_result(self, request: Request, result: DepthResult) -> None:
        with self._lock:
            lf = self._contents.lf
        if lf is not None and lf.size == result.disparity.shape:  # another light field may have been opened meanwhile
            try:
                self.add(result, name=request.name)
            except LfgpuError:
                return


def _refuse_to_share(*_: object, **__: object) -> None:
    """Prevent viser from opening a public tunnel through a server of its makers."""


@contextmanager
def _silent() -> Iterator[None]:
    """Suppress the messages of viser on the terminal."""
    import rich

    console = rich.get_console()
    before, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = before


@contextmanager
def _guarded(token: str) -> Iterator[None]:
    """Servers that start meanwhile answer nobody who does not know the token, which stands in the address of the page.

    Connections from pages of other sites, which any browser would allow, are refused. The token is the first part of
    the path: the page asks for all else relative to itself, and unlike a cookie it reaches no other port.
    """
    import websockets.asyncio.server as place

    serve = place.serve

    def guarded(handler: Any, *arguments: Any, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            first, _, rest = request.path.removeprefix("/").partition("/")
            if not secrets.compare_digest(first.partition("?")[0].encode(), token.encode()):
                return connection.respond(
                    HTTPStatus.FORBIDDEN, "The address of the page has a token; see lfgpu view.\n"
                )
            return process_request(connection, replace(request, path=f"/{rest}"))

        return serve(handler, *arguments, process_request=answer, origins=[_OWN_PAGES, None], **options)

    place.serve = guarded  # type: ignore[misc,assignment]
    try:
        yield
    finally:
        place.serve = serve  # type: ignore[misc]
