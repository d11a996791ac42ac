"""`lfgpu demo`: the whole pipeline on a synthetic scene with exact ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfgpu.cli.options import OutFolder, Threads

if TYPE_CHECKING:
    from lfgpu.data import DepthResult, LightField
    from lfgpu.metrics import Metrics

GRID, SIZE = (7, 7), (288, 384)
"""Size of the light field: half a minute of work on two CPU cores, most of it for making the views."""

_SCENE, _LIGHT_FIELD, _OVERVIEW = "still_life", "light-field", "overview.png"


def demo(
    out: OutFolder = Path("lfgpu-demo"),
    seed: Annotated[int, typer.Option(help="Seed of the random scene.")] = 0,
    threads: Threads = None,
) -> None:
    """Make a synthetic light field, estimate its depth, compare it with the exact ground truth and draw an overview."""
    from lfgpu.cli import summary, values
    from lfgpu.cli.console import output
    from lfgpu.cli.options import Estimation
    from lfgpu.cli.outputs import NAMES, write_outputs
    from lfgpu.io import RESULT_FILE, atomic_folder, check_writable, write_hci
    from lfgpu.methods import configured
    from lfgpu.scenes import make

    check_writable(out)
    values.use_threads("--threads", threads)
    console = output()
    rows, columns = GRID
    console.print(f"Making {rows * columns} views of {_SCENE}, seed {seed}, then estimating the depth of one ...")
    console.print("The first estimate on a machine compiles kernels for up to a minute.")
    lf = make(_SCENE, seed=seed, grid=GRID, size=SIZE)
    result = Estimation(configured(None)).run(lf, quiet=False)
    summary.show_input(console, lf)
    summary.show_result(console, result, range_given=False)
    scores = summary.show_scores(console, lf, result)
    with atomic_folder(out, ours=NAMES, mark=RESULT_FILE) as folder:
        write_hci(lf, folder / _LIGHT_FIELD)
        files = write_outputs(folder, result)
        _draw_overview(lf, result, scores, folder / _OVERVIEW)
    summary.show_outputs(
        console,
        out,
        [(_OVERVIEW, "start here: view, map, ground truth and error"), *files, (_LIGHT_FIELD, "the views")],
    )
    _show_next(out)


def _draw_overview(lf: LightField, result: DepthResult, scores: dict[str, Metrics], path: Path) -> None:
    from lfgpu.metrics import BORDER
    from lfgpu.viz.pictures import save_picture
    from lfgpu.viz.sheets import overview

    assert lf.truth is not None  # synthetic scenes have it
    view, title = lf.image(lf.reference_index), lf.name
    if scores:
        m = scores[next(reversed(result.stages))]
        title = (
            f"{lf.name}, {len(lf.views)} views in {result.seconds:.1f} s: BadPix(0.07) {m.badpix_07:.1f} %, "
            f"MSE x100 {m.mse_100:.2f}, Q25 x100 {m.q25:.2f}"
        )
    save_picture(overview(view, result.disparity, lf.truth.disparity, title=title, border=BORDER), path)


def _show_next(out: Path) -> None:
    from lfgpu.cli.console import output
    from lfgpu.cli.summary import show_next

    views, cross = out / _LIGHT_FIELD, f"{out}-cross"
    show_next(
        output(),
        ("lfgpu", "view", views, out),
        ("lfgpu", "depth", views, "-o", cross, "--views", "cross"),
        ("lfgpu", "eval", cross, views),
    )
