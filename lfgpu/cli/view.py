"""`lfgpu view`: a light field and its maps in the browser."""

from __future__ import annotations

import tempfile
import threading
import webbrowser
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from lfgpu.cli.options import Reading, Threads
from lfgpu.errors import LightFieldError

T = TypeVar("T")
_SOON = 0.4  # seconds: who reads for longer says first where to look


def view(
    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="INPUT_OR_RESULT...", help="A light field, and its maps or folders that `lfgpu depth` wrote."
        ),
    ],
    *,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port on 127.0.0.1; the next free one if it is taken, 0 for any.")
    ] = 8080,
    show: Annotated[bool, typer.Option("--open", help="Open the page in the browser.")] = False,
    allow_open: Annotated[
        bool,
        typer.Option("--allow-open", help="Let the page open any path, not only INPUT_OR_RESULT and what is in it."),
    ] = False,
    threads: Threads = None,
    reading: Reading,
) -> None:
    """Show a light field, its epipolar plane images, maps and points in the browser, and estimate new maps there.

    The page is reachable from this machine only, by those who know its address, which has a token. Several maps can be
    compared. With an option of reading, such as --grid, the first INPUT_OR_RESULT is read as the light field. Ctrl-C
    ends it.
    """
    from lfgpu.cli import values
    from lfgpu.viewer.place import Place, check_installed

    values.use_threads("--threads", threads)
    options = reading.options()
    for path in paths:
        if not path.exists():
            raise LightFieldError(f"{path} does not exist; give a light field, or what lfgpu depth wrote.")
    check_installed()
    try:
        from lfgpu.viewer import Viewer  # takes most of a second
        from lfgpu.viewer.contents import check_known

        check_known(paths, **options)
        place = Place(port)
        coming = _begin(lambda: Viewer.of(paths, port=place, allow_open=allow_open, **options))
        wait([coming], _SOON)
        if coming.done():
            coming.result()  # raises what was wrong
        typer.echo(f"Open {place.url} with a browser on this machine; Ctrl-C ends it.")
        with _opened(place.url) if show else nullcontext(), coming.result() as viewer:
            viewer.wait()
    except KeyboardInterrupt:
        typer.echo("Closed.")


def _begin(work: Callable[[], T]) -> Future[T]:
    """Start work in a thread that does not keep the program from ending."""
    future: Future[T] = Future()

    def run() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, name="lfgpu-reading", daemon=True).start()
    return future


@contextmanager
def _opened(url: str) -> Iterator[None]:
    """Open a page by way of a file that only its owner can read: everybody sees with what a program was started."""
    with tempfile.NamedTemporaryFile("w", prefix="lfgpu-", suffix=".html") as file:
        file.write(f'<!doctype html><meta http-equiv="refresh" content="0; url={url}"><a href="{url}">lfgpu</a>\n')
        file.flush()
        webbrowser.open(Path(file.name).as_uri())
        yield
