"""Decisions of a reader about the files of a light field, with their reasons."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Reading:
    """Decisions of a reader, with their reasons: sentences without a full stop, "" where nothing was decided."""

    places: str = ""  # which numbers, axes or entries say where the cameras stand
    pictures: str = ""  # how pictures are oriented, and which pixels are known
    lengths: str = ""  # which unit lengths have, and where they come from
    transpose: bool = False  # True if rows and columns of cameras were swapped because the caller said so
    flip: str = ""  # axes that were turned round after that because the caller said so

    def lines(self) -> list[tuple[str, str]]:
        """List a label and a sentence for each decision."""
        said = (("places", self.places), ("pictures", self.pictures), ("lengths", self.lengths))
        return [(label, sentence) for label, sentence in said if sentence]

    def advice(self, *, transpose: bool = False, flip: str = "") -> str:
        """Advise on the options of `lfgpu.read` that also turn the axes so, beside those given already; "" if none."""
        flips = set(self.flip)
        if transpose:  # what was flipped before is flipped along the other axis after it
            flips = {{"u": "v", "v": "u"}[axis] for axis in flips}
        flips ^= set(flip)
        swapped = self.transpose != transpose
        options = [*(["--transpose"] if swapped else []), *([f"--flip {''.join(sorted(flips))}"] if flips else [])]
        given = [*(["--transpose"] if self.transpose else []), *([f"--flip {self.flip}"] if self.flip else [])]
        if options:
            instead = f" instead of {' '.join(given)}" if given else ""
            return f"read it with {' '.join(options)}{instead}"
        return f"read it without {' '.join(given)}" if given else ""


NOTHING = Reading()
"""Nothing was read."""


@dataclass(frozen=True)
class Inside:
    """Facts about a file that no light field has a place for."""

    facts: tuple[tuple[str, str], ...]  # (label, text) each, in the order of importance
    no_depth: str | None = None  # a sentence that says why there is no light field in it; None if there is one
