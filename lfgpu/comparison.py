"""Comparisons of several methods on several scenes: scores and tables."""

from __future__ import annotations

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
    view: NDArray[np.float32]
    """The view that the ground truth belongs to, float32 [y, x, c] in [0, 1]."""
    truth: NDArray[np.float32]
    """The ground truth, float32 [y, x], pixels per view step; NaN where unknown or not scored."""
    maps: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """The maps by method, [y, x]."""
    border: int = BORDER

    def scores(self) -> dict[str, Metrics]:
        """The scores of each method; LightFieldError, which names scene and method, if a map has another size."""
        found = {}
        for method, values in self.maps.items():
            try:
                found[method] = evaluate(values, self.truth, border=self.border)
            except LightFieldError as error:
                raise LightFieldError(f"{method} on {self.name}: {error}") from error
        return found


@dataclass(frozen=True)
class Row:
    """One metric on one scene, with a value for each method; NaN without a map."""

    scene: str
    metric: str
    values: tuple[float, ...]

    @property
    def best(self) -> int | None:
        """Index of the smallest value; None if there is none."""
        return int(np.nanargmin(self.values)) if not all(map(math.isnan, self.values)) else None


@dataclass(frozen=True)
class Table:
    """A table with a row for each scene and metric, and a column for each method; averages come last."""

    methods: tuple[str, ...]
    rows: tuple[Row, ...]

    def cells(self, row: Row) -> list[str]:
        """The values of a row as text, all with the same number of digits."""
        digits = 3 if row.metric.endswith("x100") else 2
        return ["-" if math.isnan(value) else f"{value:.{digits}f}" for value in row.values]

    def markdown(self) -> str:
        """The table in Markdown; the best of each row is bold."""
        head = ["scene", "metric", *self.methods]
        lines = [_piped(head), "|---|---|" + "---:|" * len(self.methods)]
        for row in self.rows:
            cells = [f"**{cell}**" if i == row.best else cell for i, cell in enumerate(self.cells(row))]
            lines.append(_piped([row.scene, row.metric, *cells]))
        return "\n".join(lines) + "\n"

    def latex(self) -> str:
        """The table in LaTeX, with the package booktabs; the best of each row is bold."""
        lines = [
            f"\\begin{{tabular}}{{ll{'r' * len(self.methods)}}}",
            "\\toprule",
            " & ".join(["scene", "metric", *map(_escaped, self.methods)]) + r" \\",
        ]
        before = None
        for row in self.rows:
            if row.scene != before:
                lines.append("\\midrule")
            cells = [f"\\textbf{{{cell}}}" if i == row.best else cell for i, cell in enumerate(self.cells(row))]
            name = _escaped(row.scene) if row.scene != before else ""
            lines.append(" & ".join([name, row.metric.replace("x100", r"$\times$100"), *cells]) + r" \\")
            before = row.scene
        return "\n".join([*lines, "\\bottomrule", "\\end{tabular}"]) + "\n"

    def csv(self) -> str:
        """The table as CSV, with all digits."""
        lines = [",".join(["scene", "metric", *map(_quoted, self.methods)])]
        for row in self.rows:
            values = ["" if math.isnan(value) else repr(value) for value in row.values]
            lines.append(",".join([_quoted(row.scene), row.metric, *values]))
        return "\n".join(lines) + "\n"


def table(scenes: Sequence[Scene]) -> Table:
    """Score all methods on all scenes. Averages are over the scenes for which every method has a map.

    Raises
    ------
    LightFieldError
        If there is no scene, or a map and its ground truth differ in size.
    """
    methods = tuple(dict.fromkeys(method for scene in scenes for method in scene.maps))
    return table_of(methods, {scene.name: scene.scores() for scene in scenes})


def table_of(methods: tuple[str, ...], scores: Mapping[str, Mapping[str, Metrics]]) -> Table:
    """Make the table from scores by scene and method; LightFieldError if there is no scene."""
    if not scores:
        raise LightFieldError("there is nothing to compare; give at least one scene.")
    rows = [
        Row(scene, metric, tuple(_score(of, method, attribute) for method in methods))
        for scene, of in scores.items()
        for metric, attribute in COLUMNS.items()
    ]
    common = [of for of in scores.values() if len(of) == len(methods)]
    if len(common) > 1:
        for metric, attribute in COLUMNS.items():
            means = tuple(float(np.mean([_score(of, method, attribute) for of in common])) for method in methods)
            rows.append(Row(f"{_AVERAGE} of {len(common)}", metric, means))
    return Table(methods, tuple(rows))


def error_map(values: ArrayLike, truth: ArrayLike) -> NDArray[np.float32]:
    """Disparity minus truth, [y, x], pixels per view step; NaN where either is undefined."""
    found = np.asarray(values, np.float32) - np.asarray(truth, np.float32)
    return np.where(np.isfinite(found), found, np.float32(np.nan))


def _score(scores: Mapping[str, Metrics], method: str, attribute: str) -> float:
    return float(getattr(scores[method], attribute)) if method in scores else float("nan")


def _piped(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"


def _escaped(text: str) -> str:
    return "".join(f"\\{c}" if c in "_&%#$" else c for c in text)


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n') else text
