"""The command line `lfgpu`: one module for each command.

Commands import what they need when they run, so that help texts and wrong usage answer quickly.
"""

import atexit
import gc
import io
import os
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer

from lfgpu.cli import (
    backends,
    batch,
    check,
    convert,
    decode,
    demo,
    depth,
    doctor,
    evaluate,
    export,
    export_scene,
    info,
    live,
    parameters,
    rectify,
    render,
    scene,
    train,
    view,
)
from lfgpu.cli.failures import Group
from lfgpu.cli.listings import EXAMPLE, Command
from lfgpu.cli.options import with_groups

_OBJECTS = 50_000  # made since the last look for garbage, before the next: imports make many that stay

app = typer.Typer(
    name="lfgpu",
    cls=Group,
    help="Disparity, confidence and metric depth from 4D light fields. `lfgpu COMMAND --help` tells more.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_TASKS: dict[str, dict[str, tuple[Callable[..., Any], str]]] = {
    "Begin": {
        "demo": (demo.demo, "lfgpu demo"),
        "doctor": (doctor.doctor, "lfgpu doctor"),
        "scene": (scene.scene, "lfgpu scene boxes -o boxes --grid 7x7 --size 192x256"),
    },
    "Read": {
        "info": (info.info, "lfgpu info my/light/field"),
        "decode": (decode.decode, "lfgpu decode IMG_1.lfp -o views"),
        "check": (check.check, "lfgpu check my/light/field"),
        "rectify": (rectify.rectify, "lfgpu rectify photos --calibration cameras.toml -o rectified"),
    },
    "Estimate": {
        "depth": (depth.depth, "lfgpu depth my/light/field -o out"),
        "batch": (batch.batch, "lfgpu batch recordings -o out"),
        "live": (live.live, "lfgpu live my_rig:frames --preset fast -o maps"),
        "train": (train.train, "lfgpu train --like my/light/field -o weights.npz"),
        "export": (export.export, "lfgpu export my/light/field -o pipeline --preset fast"),
    },
    "Look and use": {
        "view": (view.view, "lfgpu view my/light/field out"),
        "render": (render.render, "lfgpu render my/light/field --refocus 0.8 -o refocused.png"),
        "convert": (convert.convert, "lfgpu convert out -o cloud.ply --image my/light/field"),
        "export-scene": (export_scene.export_scene, "lfgpu export-scene my/light/field -o scene"),
        "eval": (evaluate.evaluate, "lfgpu eval out truth.pfm"),
    },
    "Look up": {
        "backends": (backends.backends, "lfgpu backends"),
        "parameters": (parameters.parameters, "lfgpu parameters --preset fast"),
    },
}
"""The commands by task, each with an example."""

for _task, _commands in _TASKS.items():
    for _name, (_function, _example) in _commands.items():
        app.command(_name, cls=Command, rich_help_panel=_task, epilog=f"{EXAMPLE}{_example}")(with_groups(_function))


def main() -> None:
    """Run the command line and exit with a code.

    0: done. 1: an error, with one sentence on stderr. 2: wrong usage. 130: interrupted.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # file names may hold characters that the terminal cannot show
    os.environ.pop("MPLBACKEND", None)  # matplotlib refuses to load with a name that it does not know; no window opens
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")  # threads without work sleep at once, and do not spin
    gc.set_threshold(_OBJECTS)
    atexit.register(gc.freeze)  # at the end everything goes with the process: nobody has to look for what is unused
    app(prog_name="lfgpu")


def _show_version(wanted: bool) -> None:
    if wanted:
        from lfgpu.machine import version_of

        typer.echo(f"lfgpu {version_of('lfgpu') or 'not installed'}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass
