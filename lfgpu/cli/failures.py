"""Errors of commands: each becomes one sentence on stderr and an exit code."""

import _thread
import errno
import os
import shlex
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperGroup

from lfgpu.errors import LfgpuError
from lfgpu.printable import message, printable

_FAILED, _INTERRUPTED = 1, 130  # 130: the exit code of shells after Ctrl-C
_INTERRUPTION = "interrupted; outputs are whole or not there."
_LESS_MEMORY = ("--views cross", "--max-memory", "--device cpu")  # options, where the command has them

_COMMAND = "lfgpu.command"
_AGAIN = 0.2  # seconds after which Ctrl-C comes again that was lost


def command_line(ctx: typer.Context) -> str:
    """Return the command line that is running, as a shell takes it."""
    return str(ctx.meta[_COMMAND])


class Group(TyperGroup):
    """The group of all commands. Errors that users can cause become a sentence; bugs keep their traceback.

    Sentences begin with the name of the program.
    """

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Remember the command line, for reports."""
        ctx.meta[_COMMAND] = printable(shlex.join([str(ctx.info_name), *args]))
        return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the arguments name."""
        try:
            with _interruptions_arrive():
                return super().invoke(ctx)
        except typer.Exit:
            raise
        except (Exception, KeyboardInterrupt) as error:
            if is_interruption(error):
                raise self._exit(_INTERRUPTION, _INTERRUPTED) from None
            command = self.commands.get(ctx.invoked_subcommand)
            sentence = _sentence(error, {name for known in (command.params if command else ()) for name in known.opts})
            if sentence is None:
                raise
            raise self._exit(sentence, _FAILED) from error

    def _exit(self, sentence: str, code: int) -> typer.Exit:
        typer.echo(f"{self.name}: {message(sentence)}", err=True)
        return typer.Exit(code)


def is_interruption(error: BaseException | None) -> bool:
    """Tell whether an error is Ctrl-C, or was raised by what had to be tidied up after Ctrl-C."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


@contextmanager
def _interruptions_arrive() -> Iterator[None]:
    """Raise Ctrl-C again in the block where it was lost: Python drops what is raised in destructors and callbacks."""
    before = sys.unraisablehook

    def again() -> None:
        time.sleep(_AGAIN)
        if sys.unraisablehook is lost:
            os.kill(os.getpid(), signal.SIGINT)

    def lost(what: Any) -> None:
        if issubclass(what.exc_type, KeyboardInterrupt):
            _thread.start_new_thread(again, ())  # which is not waited for: here, Ctrl-C would be lost again
        else:
            before(what)

    sys.unraisablehook = before if os.name == "nt" else lost  # there, os.kill ends the process
    try:
        yield
    finally:
        sys.unraisablehook = before


def _sentence(error: BaseException, options: set[str]) -> str | None:
    """Return the sentence about an error of a command that has some options; None if it is a bug."""
    if isinstance(error, LfgpuError):
        return str(error)
    if isinstance(error, MemoryError):
        return _out_of_memory("", _LESS_MEMORY[:2], options)
    if isinstance(error, OSError):
        # A reader such as `head` that closes the pipe is no error: typer ends quietly.
        if error.errno == errno.EPIPE:
            return None
        reason = error.strerror or str(error) or type(error).__name__
        return f"{error.filename}: {reason}." if error.filename else f"{reason}."
    if "Failed to allocate" in str(error):  # the message of Warp
        return _out_of_memory(" on the device", _LESS_MEMORY, options)
    if "CUDA error" in str(error):
        return f"the GPU failed ({str(error).rstrip('.')}); run the command again, or with --device cpu."
    return None


def _out_of_memory(where: str, remedies: Sequence[str], options: set[str]) -> str:
    ways = ["fewer or smaller views", *(remedy for remedy in remedies if remedy.split()[0] in options)]
    return f"out of memory{where}; use {', '.join(ways[:-1])}{' or ' * (len(ways) > 1)}{ways[-1]}."
