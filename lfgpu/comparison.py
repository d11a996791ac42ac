"""Comparisons of several methods on several scenes: scores and tables."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfgpu.errors import LightFieldError
from lfgpu.metrics import BORDER, Metrics, evaluate

COLUMNS = {
    "MSE x100": "mse_100",
    "BadPix 0.07": "badpix_07",
    "BadPix 0.03": "badpix_03",
    "BadPix 0.01": "badpix_01",
    "Q25 x100": "q25",
}
"""The metrics of a table: their titles, and the attributes of `lfgpu.metrics.Metrics`. Smaller is better."""

_AVERAGE = "average"


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene with its ground truth, and the maps of several methods."""

    name: str
    view: NDArray[np.float32]  # the view that the ground truth belongs to, float32 [y, x, c] in [0, 1]
    truth: NDArray[np.float32]
    """The ground truth, float32 [y, x], pixels per view step; NaN where unknown or not scored."""
    maps: dict[str, NDArray[np.float32]] = field(default_factory=dict)  # the maps by method, [y, x]
    border: int = BORDER

    def scores(self) -> dict[str, Metrics]:
        """Score each method; LightFieldError, which names scene and method, if a map has another size."""
        found = {}
        for method, values in self.maps.items():
            try:
                found[method] = evaluate(values, self.truth, border=self.border)
            except LightFieldError as error:
                raise LightFieldError(f"{method} on {self.name}: {error}") from error
        return found


@dataclass(frozen=True)
class Row:
    """The scores of one method on one scene."""

    scene: str
    method: str
    values: tuple[float, ...]  # a value for each of `COLUMNS`; NaN without a map
    best: tuple[bool, ...]  # true if it is the smallest on this scene, for each of `COLUMNS`

    @property
    def cells(self) -> list[str]:
        """The values as text; those of a metric have the same number of digits in all rows."""
        digits = [3 if metric.endswith("x100") else 2 for metric in COLUMNS]
        return ["-" if math.isnan(v) else f"{v:.{n}f}" for v, n in zip(self.values, digits, strict=True)]


@dataclass(frozen=True)
class Table:
    """A table with a row for each scene and method and a column for each metric; averages come last."""

    methods: tuple[str, ...]
    rows: tuple[Row, ...]

    @property
    def scenes(self) -> dict[str, list[Row]]:
        """The rows of each scene, in order."""
        found: dict[str, list[Row]] = {}
        for row in self.rows:
            found.setdefault(row.scene, []).append(row)
        return found

    def markdown(self) -> str:
        """Write the table in Markdown; the best of each scene and metric is bold."""
        lines = [_piped(["scene", "method", *COLUMNS]), "|---|---|" + "---:|" * len(COLUMNS)]
        for row in self.rows:
            cells = [f"**{cell}**" if best else cell for cell, best in zip(row.cells, row.best, strict=True)]
            lines.append(_piped([row.scene, row.method, *cells]))
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """Write the table in LaTeX, with the package booktabs; the best of each scene and metric is bold."""
        heads = [name.replace("x100", r"$\times$100") for name in COLUMNS]
        lines = [
            f"\\begin{{tabular}}{{ll{'r' * len(COLUMNS)}}}",
            "\\toprule",
            " & ".join(["scene", "method", *heads]) + r" \\",
        ]
        for scene, rows in self.scenes.items():
            lines.append("\\midrule")
            for row in rows:
                cells = [
                    f"\\textbf{{{cell}}}" if best else cell for cell, best in zip(row.cells, row.best, strict=True)
                ]
                name = _escaped(scene) if row is rows[0] else ""
                lines.append(" & ".join([name, _escaped(row.method), *cells]) + r" \\")
        return "\n".join([*lines, "\\bottomrule", "\\end{tabular}"]) + "\n"

    def csv(self) -> str:
        """Write the table as CSV, with all digits."""
        text = io.StringIO()
        write = csv.writer(text, lineterminator="\n").writerow
        write(["scene", "method", *COLUMNS])
        for row in self.rows:
            write([row.scene, row.method, *("" if math.isnan(value) else repr(value) for value in row.values)])
        return text.getvalue()


def table(scenes: Sequence[Scene]) -> Table:
    """Score all methods on all scenes. Averages are over the scenes for which every method has a map."""
    methods = tuple(dict.fromkeys(method for scene in scenes for method in scene.maps))
    return table_of(methods, {scene.name: scene.scores() for scene in scenes})


def table_of(methods: tuple[str, ...], scores: Mapping[str, Mapping[str, Metrics]]) -> Table:
    """Make the table from scores by scene and method; LightFieldError if there is no scene."""
    if not scores:
        raise LightFieldError("there is nothing to compare; give at least one scene.")
    values = {scene: np.array([_values(of, method) for method in methods]) for scene, of in scores.items()}
    rows = [row for scene, found in values.items() for row in _best(scene, methods, found)]
    common = [values[scene] for scene, of in scores.items() if len(of) == len(methods)]
    if len(common) > 1:
        rows += _best(f"{_AVERAGE} of {len(common)}", methods, np.mean(common, axis=0))
    return Table(methods, tuple(rows))


def error_map(values: ArrayLike, truth: ArrayLike) -> NDArray[np.float32]:
    """Compute disparity minus truth, [y, x], pixels per view step; NaN where either is undefined."""
    found = np.asarray(values, np.float32) - np.asarray(truth, np.float32)
    return np.where(np.isfinite(found), found, np.float32(np.nan))


def _best(scene: str, methods: tuple[str, ...], values: NDArray[np.float64]) -> list[Row]:
    """Return the rows of a scene from values [method, metric]."""
    smallest = np.where(np.isnan(values), np.inf, values).min(axis=0)
    return [
        Row(scene, method, tuple(map(float, row)), tuple(map(bool, row == smallest)))
        for method, row in zip(methods, values, strict=True)
    ]


def _values(scores: Mapping[str, Metrics], method: str) -> list[float]:
    if method not in scores:
        return [float("nan")] * len(COLUMNS)
    return [float(getattr(scores[method], attribute)) for attribute in COLUMNS.values()]


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _escaped(text: str) -> str:
    return "".join(f"\\{c}" if c in "_&%#$" else c for c in text)
