"""Running commands in the process of the tests, and what they answer."""

import re
from dataclasses import dataclass
from pathlib import Path

from typer.testing import CliRunner

from lfgpu import scenes
from lfgpu.cli import app
from lfgpu.data import LightField

OUTPUTS = {"confidence.png", "depth.pfm", "disparity.pfm", "disparity.png", "result.npz"}
RANGE = ("--disparity-range", "-2,2")
SMALL = {"grid": (5, 5), "size": (40, 48)}


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str
    raised: BaseException | None


def lfgpu(*arguments: object) -> Outcome:
    """Run a command in this process."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    raised = None if isinstance(result.exception, SystemExit) else result.exception
    return Outcome(result.exit_code, result.stdout, result.stderr, raised)


def said(*arguments: object) -> str:
    """Return what a command that succeeds writes to stdout."""
    outcome = lfgpu(*arguments)
    assert outcome.raised is None, outcome.raised
    assert outcome.code == 0, outcome.err
    return outcome.out


def refused(outcome: Outcome, words: str, code: int = 1) -> None:
    """Exactly one sentence on stderr, with those words in it, and nothing on stdout."""
    assert outcome.raised is None
    assert outcome.code == code
    assert outcome.out == ""
    assert re.fullmatch(r"lfgpu: [^\n]*\.\n", outcome.err), outcome.err
    assert words in outcome.err


def holes(folder: Path) -> None:
    for index in (0, 7, 13):
        (folder / f"input_Cam{index:03d}.png").unlink()


def boxes() -> LightField:
    """A small scene."""
    return scenes.make("boxes", grid=(5, 5), size=(48, 56))
