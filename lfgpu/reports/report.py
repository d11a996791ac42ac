"""The report of a result: one HTML page with the input, the maps, their scores and the parameters.

It is one file without scripts, and it needs no network.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from lfgpu.cameras import Explanation
from lfgpu.config import parameters, value_of
from lfgpu.data import DepthResult, LightField
from lfgpu.data.summary import UNIT, pixels, view_at
from lfgpu.errors import LightFieldError
from lfgpu.io import REPORT_FILE as REPORT_FILE, check_writable
from lfgpu.machine import device_name
from lfgpu.methods import method_of, nearest_preset
from lfgpu.metrics import BORDER, Metrics, evaluate, reliability, sparsification
from lfgpu.printable import printable
from lfgpu.reports import charts, facts
from lfgpu.reports.epis import Point, epi_cards, find_points
from lfgpu.viz.cards import Card, Tile, cross_hair, limits_of, map_card, scale_of, trust_cards, view_card
from lfgpu.viz.pages import rendered, write_page
from lfgpu.viz.panels import rgb

_HEADS = ("MSE ×100", "BadPix 0.07 (%)", "BadPix 0.03 (%)", "BadPix 0.01 (%)", "Q25 ×100", "RMSE", "undefined (%)")
_SAME_PLACE = 1e-6  # view steps
_COMPILE = "compile"  # what `DepthResult.timings` calls the time until kernels were ready
_PARTS = {_COMPILE: "compiling and loading kernels", "measure": "range and noise", "tiles": "tiles"}
"""Labels of times that are no stages of a method."""


@dataclass(frozen=True)
class Origin:
    """Origin of a result, as far as the result does not say it itself. What is empty or None is left out."""

    source: str = ""  # the light field's file or folder
    command: str = ""  # the command line
    written: datetime | None = None  # the date of the report
    product: str | None = None  # product name of the device that computed the result

    @classmethod
    def now(cls, source: object, command: str, device: str) -> Origin:
        """Return the origin of a result that a device has just computed, by a command."""
        return cls(printable(str(source)), command, datetime.now().astimezone(), device_name(device))


def write_report(
    path: str | os.PathLike[str],
    lf: LightField,
    result: DepthResult,
    *,
    origin: Origin | None = None,
    explanation: Explanation | None = None,
) -> None:
    """Write a report of a result: one HTML page for any browser, which needs no network and can be printed.

        lfgpu.write_report("report.html", lf, result, explanation=lfgpu.explain(lf, result))

    Parameters
    ----------
    path
        The file; it is written whole or not at all.
    lf
        The light field.
    result
        A result of its reference view.
    origin
        Where the result comes from. Default None: the report does not say.
    explanation
        What `lfgpu.explain` says of both. Default None: the report leaves it out.

    Raises
    ------
    LightFieldError
        If the result is of another view or size than the light field, or the file cannot be written.

    Examples
    --------
    >>> lfgpu.write_report("report.html", lf, result)
    """
    check_writable(path, folder=False)
    write_page(path, html(lf, result, origin=origin, explanation=explanation))


def html(
    lf: LightField,
    result: DepthResult,
    *,
    origin: Origin | None = None,
    explanation: Explanation | None = None,
) -> str:
    """Return the report as text; arguments and errors as for `write_report`."""
    _check(lf, result)
    origin = origin or Origin()
    points = find_points(lf, result.disparity)
    scored = _Scored.of(lf, result)
    return rendered(
        "report.html",
        title=f"{result.name}: depth by lfgpu",
        name=result.name,
        lead=_lead(result, origin),
        tiles=list(_tiles(result, scored, explanation)),
        cards=_maps(lf, result, points),
        scored=scored,
        heads=_HEADS,
        border=BORDER,
        distributions=_distributions(lf, result),
        points=points,
        epis=[card for point in points for card in epi_cards(lf, result.disparity, point)],
        judged=None if explanation is None else judged(explanation),
        facts=[*([("read from", origin.source)] if origin.source else []), *facts.typeset_rows(lf)],
        run=_run(result, origin),
        command=origin.command,
        charts=_run_charts(result),
        preset=facts.preset(result.config),
        parameters=_parameters(result),
    )


def _check(lf: LightField, result: DepthResult) -> None:
    here = lf.positions[lf.reference_index]
    if result.disparity.shape != lf.size or np.abs(here - result.position).max() > _SAME_PLACE:
        raise LightFieldError(
            f"the result is of {pixels(result.disparity.shape)} of the view at {view_at(result.position)}, "
            f"but the reference of {lf.name} has {pixels(lf.size)} and is at {view_at(here)}; give the light "
            "field that it was estimated from, with the same reference view."
        )


# --- what is read first ---


def _lead(result: DepthResult, origin: Origin) -> str:
    version = result.versions.get("lfgpu", "")
    by = f"Disparity of the view at {view_at(result.position)}, by lfgpu {version}".rstrip()
    return by if origin.written is None else f"{by}, {facts.date(origin.written)}"


def _tiles(result: DepthResult, scored: _Scored | None, explanation: Explanation | None) -> Iterator[Tile]:
    if scored is not None and scored.final is not None:
        m = scored.final
        yield Tile("BadPix 0.07", f"{m.badpix_07:.2f}", "%", "more than 0.07 px off")
        yield Tile("MSE ×100", f"{m.mse_100:.3f}", "px²", "mean squared error")
    known = result.disparity[np.isfinite(result.disparity)]
    undefined = 100 * (1 - known.size / result.disparity.size)
    where = f", {undefined:.2g} % undefined" if undefined else ""
    yield Tile("Disparity", _span(known), "", f"{UNIT}{where}")
    if result.depth is not None:
        metres = result.depth[np.isfinite(result.depth)]
        beyond = " and beyond the horizon" if np.isinf(result.depth).any() else ""
        yield Tile("Depth", _span(metres), "m", f"along the optical axis{beyond}")
    if result.seconds is not None:
        compiling = result.timings.get(_COMPILE, 0.0)
        apart = f"and {compiling:.2f} s to compile and load kernels" if compiling else "of the estimate"
        yield Tile("Time", f"{result.seconds:.2f}", "s", apart)
    if explanation is not None and np.isfinite(explanation.mean_psnr):
        yield Tile(
            "Predicted views", f"{explanation.mean_psnr:.1f}", "dB", "PSNR of the views as the map predicts them"
        )
    if scored is None:
        sure = 100 * float((result.confidence[np.isfinite(result.disparity)] > 0.5).mean()) if known.size else 0.0
        yield Tile("Confidence", f"{sure:.0f}", "%", "of the pixels above 0.5")


def _span(values: NDArray[Any]) -> str:
    """Return the ends of some values, with about three digits: "−1.53 to 1.39"."""
    if not values.size:
        return "undefined"
    low, high = float(values.min()), float(values.max())
    largest = max(abs(low), abs(high), 1e-6)
    digits = int(np.clip(2 - np.floor(np.log10(largest)), 0, 4))
    return f"{low:.{digits}f} to {high:.{digits}f}".replace("-", "\u2212")


# --- maps ---


def _maps(lf: LightField, result: DepthResult, points: list[Point]) -> list[Card]:
    truth = lf.reference_truth()
    limits = limits_of("disparity", result.disparity if truth is None else truth.disparity)
    height, width = lf.size
    marks = tuple(cross_hair(p.x + 0.5, p.y + 0.5, (width, height), p.letter) for p in points)
    view = rgb(lf.views[lf.reference_index], lf.scale)
    found = [
        view_card("Reference view", view, remark=facts.reference(lf), marks=marks),
        map_card("Disparity", result.disparity, "disparity", limits=limits),
    ]
    if truth is not None:
        found += [map_card("Ground truth", truth.disparity, "disparity", limits=limits)]
        found += [map_card("Error", result.disparity - truth.scored, "error")]
    found += trust_cards(result.map)
    if result.depth is not None:
        found.append(map_card("Depth", np.where(np.isfinite(result.depth), result.depth, np.float32(np.nan)), "depth"))
    return found


def _distributions(lf: LightField, result: DepthResult) -> list[Card]:
    truth = lf.reference_truth()
    true = None if truth is None else truth.disparity
    found = [_chart("Distribution of disparity", charts.distribution(result.disparity, f"disparity, {UNIT}", true))]
    if result.depth is not None:
        geometry = result.geometry
        metres = None if true is None or geometry is None else geometry.depth(true)
        found.append(_chart("Distribution of depth", charts.distribution(result.depth, "depth, m", metres)))
    return found


def _chart(title: str, figure: Figure, remark: str = "") -> Card:
    return Card(title, remark, drawing=charts.svg(figure, title))


# --- against the truth ---


@dataclass(frozen=True)
class _Scored:
    """The scores of the stages, or why there are none, and the curves of the confidence."""

    rows: list[tuple[str, list[str]]]
    final: Metrics | None
    cards: list[Card]
    problem: str = ""

    @classmethod
    def of(cls, lf: LightField, result: DepthResult) -> _Scored | None:
        truth = lf.reference_truth()
        if truth is None:
            return None
        try:
            scores = {
                name: evaluate(values, truth.disparity, mask=truth.mask)
                for name, values in result.disparity_stages.items()
            }
            final = evaluate(result.disparity, truth.disparity, mask=truth.mask)
            curve = sparsification(result.disparity, result.confidence, truth.disparity, mask=truth.mask)
            diagram = reliability(result.disparity, result.confidence, truth.disparity, mask=truth.mask)
        except LightFieldError as error:
            return cls([], None, [], f"The result cannot be scored: {error}")
        labels = _labels(result)
        rows = [(labels.get(name, name), _cells(m)) for name, m in scores.items()]
        area = (
            f"bad pixels among the most confident ones; area between the curves {curve.ause:.3f} (AUSE, 0 is best)"
            if np.isfinite(curve.ause)
            else ""
        )
        rare = f"right pixels at each confidence that at least {charts.LEAST_SHARE:g} % of the pixels have"
        return cls(
            rows,
            final,
            [
                _chart("Sparsification", charts.sparsification(curve), area),
                _chart("Reliability", charts.reliability(diagram), rare),
            ],
        )


def _cells(m: Metrics) -> list[str]:
    shares = (m.badpix_07, m.badpix_03, m.badpix_01)
    return [f"{m.mse_100:.3f}", *(f"{s:.2f}" for s in shares), f"{m.q25:.3f}", f"{m.rmse:.4f}", f"{m.undefined:.2f}"]


# --- without truth ---


def judged(found: Explanation) -> dict[str, Any]:
    """Collect what `lfgpu.explain` says: sentences, numbers, and the cameras and the unexplained part as cards."""
    known = found.psnr[np.isfinite(found.psnr)].astype(np.float32)
    limits = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    if limits[1] - limits[0] < 1.0:  # dB: what differs by less is alike
        limits = (sum(limits) / 2 - 0.5, sum(limits) / 2 + 0.5)
    figure, arrow = charts.cameras(found, limits)
    title = "Cameras"
    shifts = f"arrow: shift of a view, {arrow:.2g} px if as long as a square"
    error = float(np.sqrt(np.nanmean(found.shift_error**2))) if np.isfinite(found.shift_error).any() else float("nan")
    predicted = 100 * float(np.delete(found.predicted, found.reference).mean()) if len(found.psnr) > 1 else 0.0
    return {
        "findings": list(found.findings),
        "numbers": f"The map predicts {predicted:.0f} % of the pixels of the other views, with a PSNR of "
        f"{found.mean_psnr:.1f} dB. Points in the views are {found.misalignment:.3f} px (rms) away from "
        f"where the cameras' positions put them; the standard error is {error:.3f} px.",
        "cards": [
            Card(title, shifts, drawing=charts.svg(figure, title), scale=scale_of("predicted", known, limits)),
            map_card(
                "Prediction error", found.unexplained, "unexplained", remark="of all views, at the reference's pixels"
            ),
        ],
    }


# --- input, run, parameters ---


def _run(result: DepthResult, origin: Origin) -> list[tuple[str, str]]:
    low, high = result.disparity_range
    return [
        ("preset", facts.preset(result.config)),
        ("searched range", f"{low:.3f} to {high:.3f} {UNIT}".replace("-", "\u2212")),
        *(("note", note) for note in result.notes),
        *(("cameras", sentence) for sentence in result.remarks),
        ("computed by", f"{result.backend} on {facts.device(result.device, origin.product)}"),
        ("versions", ", ".join(f"{name} {version}" for name, version in result.versions.items())),
        ("converged", "yes" if result.converged else "no; more iterations may improve the map"),
        ("status", result.status),
    ]


def _run_charts(result: DepthResult) -> list[Card]:
    labels = _labels(result)
    parts = {name: value for name, value in result.timings.items() if name != "total" and value > 0}
    seconds = {labels.get(name, name): value for name, value in parts.items()}
    found = []
    if seconds:
        once = "kernels are compiled once and kept" if _COMPILE in parts else ""
        found.append(_chart("Time of each stage", charts.times(seconds), once))
    stage = method_of(result.config).traced
    values = np.asarray(result.trace, np.float64)
    values = values[np.isfinite(values)]
    if len(values) > 1:
        title = f"{(stage.value or '').capitalize()} of the {stage.label}"
        found.append(_chart(title, charts.trace(stage, values), stage.unit or ""))
    return found


def _labels(result: DepthResult) -> dict[str, str]:
    """Return the names of stages and other parts of a run, for people."""
    return {**_PARTS, **{stage.name: stage.label for stage in method_of(result.config).stages}}


def _parameters(result: DepthResult) -> list[dict[str, Any]]:
    changed = nearest_preset(result.config)[1]
    return [
        {
            "name": name,
            "value": value_of(result.config, name),
            "doc": field.metadata["doc"],
            "changed": name in changed,
        }
        for name, field in parameters(result.config)
    ]
