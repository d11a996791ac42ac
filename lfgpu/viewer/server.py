"""The viewer: a page in the browser that shows a light field and its maps, also while they change."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from html import escape
from typing import Any

from lfgpu.data import DepthResult, DisparityMap, LightField
from lfgpu.viewer.board import Board
from lfgpu.viewer.late import import_all
from lfgpu.viewer.place import Place, check_installed


class Viewer(Board):
    """A page in the browser, on this machine only, that shows a light field and its disparity maps.

        viewer = lfgpu.Viewer(lf, result)
        viewer.url                              # http://127.0.0.1:8080/…/, with a token that nobody else knows
        viewer.update(disparity, confidence)    # from any thread, as often as there is a new one
        viewer.close()

    Every tab of the browser has its own settings; all show the same light field and maps. A tab asks for what it draws
    and skips what came in between, so neither many frames nor a slow browser hold up who calls `update`.

    Parameters
    ----------
    lf, result
        What to show first; None for nothing yet.
    port
        Of 127.0.0.1; the next free one if it is taken. 0 takes any. Or a `Place`, which is taken already. Default
        8080.
    allow_open
        Whether pages may open any path that its owner can read; else those only that `of` or `load` was given, and what
        lies in them. Default False.

    Raises
    ------
    LightFieldError
        If viser or tornado is not installed, or the result is not of the light field's size.

    Examples
    --------
    >>> with lfgpu.Viewer(lf, result, port=0) as viewer:
    ...     viewer.url.startswith("http://127.0.0.1:")
    True
    """

    def __init__(
        self,
        lf: LightField | None = None,
        result: DepthResult | DisparityMap | None = None,
        *,
        port: int | Place = 8080,
        allow_open: bool = False,
    ) -> None:
        check_installed()
        from lfgpu.viewer.web import Server

        super().__init__(allow_open=allow_open)
        self._closed = threading.Event()
        if lf is not None:
            import_all()  # who has a light field may go on with kernels of his own while pages are looked at
            self.show(lf, result)
        elif result is not None:
            self.add(result)
        self._place = port if isinstance(port, Place) else Place(port)
        self._server = Server(self, self._place)

    @classmethod
    def of(
        cls,
        paths: Sequence[str | os.PathLike[str]],
        *,
        port: int | Place = 8080,
        allow_open: bool = False,
        **reading: Any,
    ) -> Viewer:
        """Make a viewer of files: at most one light field, and maps of it.

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
        viewer = cls(port=port, allow_open=allow_open)
        try:
            viewer.load(paths, **reading)
        except BaseException:
            viewer.close()
            raise
        return viewer

    def __repr__(self) -> str:
        contents = self.contents
        shown = "nothing" if contents.lf is None else repr(contents.lf.name)
        maps = f", maps {', '.join(contents.entries)}" if contents.entries else ""
        return f"<Viewer {'closed' if self._closed.is_set() else f'at {self.url}'}: {shown}{maps}>"

    def _repr_html_(self) -> str:
        """Return the page itself, for notebooks of this machine."""
        if self._closed.is_set():
            return escape(repr(self))
        link = f'<a href="{self.url}" target="_blank">{self.url}</a>'
        return f'<iframe src="{self.url}" width="100%" height="640" style="border: 1px solid #8888"></iframe>{link}'

    @property
    def url(self) -> str:
        """The address of the page; whoever knows it can use the page."""
        return self._place.url

    def close(self) -> None:
        """Stop the solver, tell all tabs and free the port."""
        if self._closed.is_set():
            return
        self._closed.set()
        self.solver.close()
        self._server.close()

    def wait(self) -> None:
        """Wait until `close` is called from another thread."""
        while not self._closed.wait(0.5):  # so that Ctrl-C is heard everywhere
            pass

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
