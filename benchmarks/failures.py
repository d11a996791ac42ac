"""What a person can cause becomes one sentence on stderr and an exit code; bugs keep their traceback."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

from lfgpu.errors import LfgpuError

_FAILED, _INTERRUPTED = 1, 130


class Group(TyperGroup):
    """The commands."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the arguments name."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise _exit("interrupted, nothing was written.", _INTERRUPTED) from None
        except LfgpuError as error:
            raise _exit(" ".join(str(error).split()), _FAILED) from error


def _exit(sentence: str, code: int) -> typer.Exit:
    typer.echo(f"benchmarks: {sentence}", err=True)
    return typer.Exit(code)
