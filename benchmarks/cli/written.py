"""What was measured before: tables, plots, comparisons, pictures, figures of pages."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from benchmarks import compare, figures, gallery, merge, plot, results, show
from benchmarks.cli.options import Files
from benchmarks.errors import BenchmarkError
from lfgpu.io.atomic import check_writable


def table(files: Files) -> None:
    """Print results as Markdown, a section for each machine."""
    typer.echo("\n".join(show.markdown(run) for run in merge.merged(map(results.load, files))), nl=False)


def plot_(
    files: Files,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE", help=".png, .svg or .pdf")],
) -> None:
    """Draw time against the size of the light field."""
    plot.write(merge.merged(map(results.load, files)), out)


def compare_(
    old: Annotated[Path, typer.Argument(metavar="OLD.json")],
    new: Annotated[Path, typer.Argument(metavar="NEW.json")],
    threshold: Annotated[float, typer.Option(min=0, help="Percent.")] = 10,
) -> None:
    """Say what got slower, faster or worse; exit with 1 if something got slower or worse."""
    found = compare.compare(results.load(old), results.load(new), threshold / 100)
    for warning in found.warnings:
        typer.echo(f"warning: {warning}", err=True)
    for title, lines in compare.sections(found):
        for line in lines:
            typer.echo(f"{title}: {line}")
    typer.echo(
        f"{found.compared} compared, {len(found.slower)} slower, {len(found.faster)} faster, {len(found.worse)} worse."
    )
    if found.fails:
        raise typer.Exit(1)


def gallery_(
    out: Annotated[Path, typer.Option("-o", "--out", metavar="FILE.png", help="Where the picture goes.")] = Path(
        "docs/gallery.png"
    ),
) -> None:
    """Draw the picture of the site's first page: three scenes, their disparity, its error, and points in space."""
    check_writable(out, folder=False)
    for line in gallery.write(out):
        typer.echo(line)


def figures_(
    check: Annotated[bool, typer.Option("--check", help="Write nothing; exit with 1 if a page differs.")] = False,
    list_: Annotated[bool, typer.Option("--list", help="Write nothing; print what each figure comes from.")] = False,
) -> None:
    """Write the figures of README, docs and benchmarks anew from the files in benchmarks/results."""
    if not (check or list_):
        for page in figures.write():
            typer.echo(f"written: {page.relative_to(figures.ROOT)}")
        return
    found = [mark for page in figures.pages() for mark in figures.marks(page)]
    differing = [mark for mark in found if mark.found != mark.wanted]
    for line in figures.listing(found if list_ else differing):
        typer.echo(line)
    if check and differing:
        raise BenchmarkError(f"{len(differing)} figures differ from their files: run python -m benchmarks figures.")
