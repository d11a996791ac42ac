"""Colours of maps: the look of each kind of map, and pixels from values.

A picture with a palette has the steps of the colour map, the grey of undefined pixels, and greys for text.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

UNDEFINED = (158, 158, 158)
"""The grey of undefined pixels, which occurs in no colour map."""

STEPS, GREYS = 239, 16
"""Colours of a palette: steps of the colour map, and greys from the paper to the ink."""

GREY, PAPER = STEPS, STEPS + 1
"""Places in a palette: undefined pixels, and the first of the greys."""

_TABLES = {
    "viridis": (
        "44015446085c471063481769481d6f482475472a7a46307e453781433d844142873f48893d4e8a3a538b38598c355e8d33638d31688e"
        "2e6d8e2c718e2a768e297b8e27808e25848e23898e218e8d20928c1f978b1e9c891fa18821a58524aa8328ae802eb37c35b7793dbc74"
        "46c06f50c46a5ac86465cb5e70cf577cd25089d54895d840a2da37b0dd2fbddf26cae11fd8e219e5e419f1e51dfde725"
    ),
    "cividis": (
        "00224e002656002a5f002d68003070083370163770203a6f273e6e2e416d34456c3a486c3f4c6c444f6c49536c4e566c535a6d575d6d"
        "5c616e60646f656870696b716d6f727272747676767a7a787e7d788381798885788d8878928c789690779b9476a09875a59c74aaa073"
        "afa471b5a86fbaac6dbfb06bc4b468c9b965cfbd62d4c15fdac65bdfca57e5cf52ead34cf0d846f6dd3ffce236fee838"
    ),
}
"""Colours from low to high in equal steps: matplotlib's maps of these names, which `lfgpu depth` draws without it."""


@dataclass(frozen=True)
class Look:
    """The words and the colours of one kind of map."""

    label: str
    unit: str
    hint: str
    colours: str  # the name of a colour map of matplotlib

    @property
    def title(self) -> str:
        """The words beside a scale."""
        label = self.label[0].lower() + self.label[1:]
        return f"{label}{f', {self.unit}' if self.unit else ''}{f' ({self.hint})' if self.hint else ''}"


_STEP = "px per view step"

LOOKS = {
    "disparity": Look("Disparity", _STEP, "larger is nearer", "viridis"),
    "depth": Look("Depth", "m", "", "viridis_r"),
    "confidence": Look("Confidence", "", "0 to 1, larger is surer", "cividis"),
    "uncertainty": Look("Uncertainty", _STEP, "expected error as a standard deviation", "magma"),
    "error": Look("Error", _STEP, "red: too near, blue: too far", "RdBu_r"),
    "unexplained": Look("Rms difference of the other views", "share of full intensity", "", "magma"),
    "predicted": Look("Predicted views: PSNR", "dB", "larger is better", "viridis"),
}
"""The looks of maps by the name of their kind."""


def shades(colours: str, count: int) -> NDArray[np.uint8]:
    """Return the colours [count, 3] of a colour map of matplotlib at equal distances, from low to high."""
    if colours not in _TABLES:
        from matplotlib import colormaps

        return np.asarray(colormaps[colours](np.linspace(0, 1, count))[:, :3] * 255 + 0.5, np.uint8)
    table = np.frombuffer(bytes.fromhex(_TABLES[colours]), np.uint8).reshape(-1, 3)
    at = np.linspace(0, len(table) - 1, count)
    steps = [np.interp(at, np.arange(len(table)), table[:, channel]) for channel in range(3)]
    return np.round(np.stack(steps, axis=1)).astype(np.uint8)


def palette(colours: str, paper: tuple[int, int, int] = (255, 255, 255)) -> NDArray[np.uint8]:
    """Return a palette [256, 3]: `STEPS` of a colour map, `UNDEFINED`, and `GREYS` from the paper to the ink.

    The ink is black or white, whichever is read better on the paper.
    """
    ink = 0.0 if sum(paper) > 3 * 127 else 255.0
    greys = np.linspace(paper, [ink] * 3, GREYS).round().astype(np.uint8)
    return np.concatenate([shades(colours, STEPS), np.array([UNDEFINED], np.uint8), greys])


def indices(values: NDArray[np.float32], limits: tuple[float, float]) -> NDArray[np.uint8]:
    """Return the places in a palette of the values of a map [y, x]."""
    low, high = limits
    share = (values - np.float32(low)) * np.float32(1 / max(high - low, 1e-30))
    known = np.isfinite(values)
    steps = np.clip(np.where(known, share, 0) * (STEPS - 1) + 0.5, 0, STEPS - 1)
    return np.where(known, steps, GREY).astype(np.uint8)


def painted(values: NDArray[np.float32], colours: str, limits: tuple[float, float]) -> NDArray[np.uint8]:
    """Paint a map [y, x]: uint8 [y, x, 3]; undefined pixels are grey."""
    return palette(colours)[indices(values, limits)]
