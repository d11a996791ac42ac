"""The command line `lfgpu`: one module for each command.

Commands import what they need when they run, so that help texts and wrong usage answer quickly.
"""

from __future__ import annotations

import io
import sys
from typing import Annotated

import typer

from lfgpu.cli import (
    backends,
    batch,
    check,
    convert,
    decode,
    demo,
    depth,
    evaluate,
    export,
    export_scene,
    info,
    live,
    parameters,
    rectify,
    render,
    scene,
    view,
)
from lfgpu.cli.failures import Group
from lfgpu.cli.listings import Command

app = typer.Typer(
    name="lfgpu",
    cls=Group,
    help="Disparity, confidence and metric depth from 4D light fields.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("depth", cls=Command)(depth.depth)
app.command("batch", cls=Command)(batch.batch)
app.command("info", cls=Command)(info.info)
app.command("check", cls=Command)(check.check)
app.command("decode", cls=Command)(decode.decode)
app.command("convert", cls=Command)(convert.convert)
app.command("rectify", cls=Command)(rectify.rectify)
app.command("render", cls=Command)(render.render)
app.command("scene", cls=Command)(scene.scene)
app.command("eval", cls=Command)(evaluate.evaluate)
app.command("view", cls=Command)(view.view)
app.command("live", cls=Command)(live.live)
app.command("export", cls=Command)(export.export)
app.command("export-scene", cls=Command)(export_scene.export_scene)
app.command("demo", cls=Command)(demo.demo)
app.command("backends", cls=Command)(backends.backends)
app.command("parameters", cls=Command)(parameters.parameters)


def main() -> None:
    """Run the command line and exit with a code.

    0: done. 1: an error, with one sentence on stderr. 2: wrong usage. 130: interrupted.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # file names may hold characters that the terminal cannot show
    app(prog_name="lfgpu")


def _show_version(wanted: bool) -> None:
    if wanted:
        import importlib.metadata

        typer.echo(f"lfgpu {importlib.metadata.version('lfgpu')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass
