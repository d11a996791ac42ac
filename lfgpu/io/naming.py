"""The numbers in the names of pictures: what each of them counts (row, column, camera, time ...), and why."""

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import accumulate, pairwise, permutations
from pathlib import Path
from types import MappingProxyType

from lfgpu.errors import LightFieldError

ROW, COLUMN, CAMERA, TIME, EXPOSURE, UNKNOWN = "row", "column", "camera", "time", "exposure", "unknown"
CONSTANT = "constant"
WORD = "the word {} says so"
BESIDE = "two numbers beside each other"
"""Reasons: of a word, and of the convention for rows and columns without words."""

_WORDS = {
    ROW: "row rows r v y line",
    COLUMN: "column columns col cols c u x",
    CAMERA: "camera cameras cam cams view views viewpoint sensor",
    TIME: "frame frames time t timestamp date shot take scene run sequence seq",
    EXPOSURE: "exposure exp iso ev gain shutter",
}
_MEANINGS = {word: meaning for meaning, words in _WORDS.items() for word in words.split()}
_FIELDS = _MEANINGS | {"n": CAMERA, "index": CAMERA, "h": COLUMN}
"""Names that `--pattern` gives to numbers."""
_SHORT = {ROW: "v", COLUMN: "u", CAMERA: "n", TIME: "t", EXPOSURE: "exposure"}
"""The names that are proposed."""

_WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+")
_SIGN = re.compile(r"(?:.*[^0-9A-Za-z+-])?[+-]", re.DOTALL)  # at the end of what stands before a number
_PLACE_DIGITS = 3  # rows and columns without words have no more
_LONGEST = 18  # digits; no longer number is taken for one
_NO_PLACE = 10  # digits of seconds since 1970; no place has so many
_FIRST_YEAR, _LAST_YEAR = 1990, 2040
SIDE = re.compile(r"left|right|cent(?:er|re)|middle|(?<![A-Z0-9])[lmr](?![A-Z0-9])", re.IGNORECASE)
"""Words for cameras beside each other."""
_IN_PAIRS = frozenset("rcvs")
"""Letters that mean too much else (view, version, camera) where no other letter names the other axis."""


@dataclass(frozen=True)
class Name:
    """The name of a picture below its folder, without suffix: texts and the numbers between them."""

    file: Path
    texts: tuple[str, ...]
    digits: tuple[str, ...]
    numbers: tuple[int, ...]


@dataclass(frozen=True)
class Number:
    """One of the numbers that pictures of a kind have in their names."""

    meaning: str
    why: str
    values: tuple[int, ...]  # of each picture

    @property
    def varies(self) -> bool:
        return len(set(self.values)) > 1


@dataclass(frozen=True)
class Naming:
    """Pictures that are named alike, and what the numbers in their names count."""

    names: tuple[Name, ...]
    numbers: tuple[Number, ...]

    def of(self, meaning: str) -> list[Number]:
        """Return the numbers of a meaning that differ between pictures; of rows and columns also those that do not."""
        return [n for n in self.numbers if n.meaning == meaning and (n.varies or meaning in (ROW, COLUMN))]

    @property
    def places(self) -> list[tuple[int, ...]]:
        """The row, column and camera of each picture, as far as there are such numbers."""
        numbers = [n for meaning in (ROW, COLUMN, CAMERA) for n in self.of(meaning)]
        return values(numbers) if numbers else [()] * len(self.names)

    @property
    def files(self) -> list[Path]:
        """The pictures."""
        return [name.file for name in self.names]

    def pattern(self, named: Mapping[int, str] = MappingProxyType({})) -> str:
        """Return the pattern of the names for `--pattern`; `named` gives other names to numbers, "" to leave them."""
        first, parts = self.names[0], []
        for place, (text, digits, number) in enumerate(zip(first.texts, first.digits, self.numbers, strict=False)):
            usual = _SHORT.get(number.meaning, "?") if number.varies or number.meaning in (ROW, COLUMN) else ""
            name = named.get(place, usual)
            parts += [text, f"{{{name}}}" if name else digits]
        return "".join([*parts, first.texts[-1]]) + first.file.suffix

    def sentence(self, folder: Path) -> str:
        """Describe what the numbers were taken for, with the reasons."""
        told: dict[str, list[str]] = {}
        for number in self.numbers:
            if number.varies or number.meaning in (ROW, COLUMN):
                told.setdefault(number.why, []).append(number.meaning)
        meanings = "; ".join(f"{' and '.join(them)}{f' ({why})' * bool(why)}" for why, them in told.items())
        return f"the numbers in names such as {self.names[0].file.relative_to(folder)} are {meanings or 'all the same'}"


def values(numbers: Sequence[Number]) -> list[tuple[int, ...]]:
    """Return the values of several numbers, for each picture."""
    return list(zip(*(number.values for number in numbers), strict=True))


def _signed(name: Name, words: Collection[str] | None = None) -> Name:
    """Return the same name if the characters before its numbers are signs of them; only right after `words`, if any."""
    texts, numbers = list(name.texts), list(name.numbers)
    for place, text in enumerate(texts[:-1]):
        if words is not None:
            signed = text[-1:] in ("+", "-") and text[:-1].casefold() in words
        else:  # A sign follows something else than the number before it: "1_-2", but not "1-2".
            signed = (place == 0 or len(text) > 1) and _SIGN.fullmatch(text) is not None
        if signed:
            texts[place], numbers[place] = text[:-1], -numbers[place] if text[-1] == "-" else numbers[place]
    return Name(name.file, tuple(texts), name.digits, tuple(numbers))


def _through_zero(names: Iterable[Name]) -> set[str]:
    """Find what ends in a letter and stands before 0 and before a minus: a sign there, unless -0 is written."""
    before = [(text.casefold(), n) for name in names for text, n in zip(name.texts, name.numbers, strict=False)]
    zeros, texts = {text for text, number in before if number == 0}, {text for text, _ in before}
    words = {text.removesuffix("+") for text in zeros}
    return {word for word in words if word[-1:].isalpha() and f"{word}-" in texts - zeros}


def families(files: Iterable[Path], folder: Path) -> list[list[Name]]:
    """Files whose names have numbers, those that are named alike but for the numbers together; the most first."""
    files = list(files)
    plain = []
    for file in files:
        parts = re.split(r"([0-9]+)", file.relative_to(folder).with_suffix("").as_posix())
        if digits := tuple(parts[1::2]):
            plain.append(Name(file, tuple(parts[::2]), digits, tuple(int(text[:_LONGEST]) for text in digits)))
    words = _through_zero(plain)
    plain = [_signed(name, words) for name in plain]
    signed = [_signed(name) for name in plain]
    pairs = list(zip(plain, signed, strict=True))
    below = {k for name, other in pairs for k, number in enumerate(other.numbers) if number < name.numbers[k]}
    # A minus alone may as well be a hyphen: "view_-01_-02".
    above = all(any(len(n.numbers) > place and n.numbers[place] > 0 for n in signed) for place in below)
    if below and (any("+" in name.file.stem for name in plain) or above):
        plain = signed
    found: dict[tuple[str, ...], list[Name]] = defaultdict(list)
    for name in plain:
        found[tuple(text.casefold() for text in name.texts)].append(name)
    kinds = [sorted(kind, key=lambda name: name.numbers) for kind in (*found.values(), *_sides(files, folder))]
    return sorted(kinds, key=len, reverse=True)


def _sides(files: Iterable[Path], folder: Path) -> list[list[Name]]:
    """Find a picture of each side, whose names differ by left and right (and centre) alone; none if there are more."""
    found: dict[tuple[str, str], list[Name]] = defaultdict(list)
    for file in files:
        stem = file.relative_to(folder).with_suffix("").as_posix()
        for side in SIDE.finditer(stem):
            texts = (stem[: side.start()], stem[side.end() :])
            name = Name(file, texts, (side[0],), (_counted(side[0]),))
            found[texts[0].casefold(), texts[1].casefold()].append(name)
    pairs = [names for names in found.values() if {0, 2} <= {name.numbers[0] for name in names}]
    return pairs if len(pairs) == 1 else []


def _counted(text: str) -> int:
    """Return a number as it is written, or the column of a side: 0, 1 or 2."""
    return int(text[:_LONGEST]) if text.lstrip("+-").isdigit() else {"l": 0, "r": 2}.get(text[0].lower(), 1)


def understood(names: Sequence[Name]) -> Naming:
    """Decide what numbers count: by the words beside them, as dates, and by the convention for two without words."""
    first, columns = names[0], list(zip(*(name.numbers for name in names), strict=True))
    varying = {place for place, values in enumerate(columns) if len(set(values)) > 1}
    words = [word(text, first=not place) for place, text in enumerate(first.texts[:-1])]
    behind = [_word_behind(text) for text in first.texts[1:]]
    if len(behind) > 1 and all(behind) and not words[0]:  # "0row_2col"
        words = behind
    meanings = _believed(words)
    for place, why in _moments(names).items():
        meanings[place] = (TIME, why)
    if not first.digits[0].isdigit():
        meanings[0] = (COLUMN, f"the words {first.digits[0]} and {names[-1].digits[0]} say so")
    _name_pair(names, words, meanings, varying)
    _name_rest(words, columns, meanings, varying)
    _name_counter(columns, meanings, varying)
    return Naming(tuple(names), tuple(Number(*what, tuple(v)) for what, v in zip(meanings, columns, strict=True)))


def word(before: str, *, first: bool = False) -> str:
    """Return the word before a number, in lower case; "/" where it begins the name of a file in a folder."""
    if before.strip().lower() == "x" and before == before[::-1] and not first:  # 3x4, 3 x 4: three by four
        return ""
    found = _WORD.findall(before.rsplit("/", 1)[-1])
    return str(found[-1]).lower() if found else "/" * ("/" in before)


def _word_behind(after: str) -> str:
    """Return the known word right behind a number; "" if there is none: "5px" and "3x4" have none."""
    found = re.match("[A-Za-z]{2,}", after)
    return found[0].lower() if found and found[0].lower() in _MEANINGS else ""


def _believed(words: Sequence[str]) -> list[tuple[str, str]]:
    """Return the meaning of each number by its word, and why."""
    table = _MEANINGS | ({"s": COLUMN, "t": ROW} if {"s", "t"} <= set(words) else {})
    axes = {table.get(word) for word in words} & {ROW, COLUMN}
    return [
        (UNKNOWN, "")
        if word not in table or (word in _IN_PAIRS and len(axes) < 2)
        else (table[word], WORD.format(word))
        for word in words
    ]


def _name_pair(names: Sequence[Name], words: Sequence[str], meanings: list[tuple[str, str]], varying: set[int]) -> None:
    """Two numbers beside each other, the second of them without a word, are row and column: "view_00_03"."""
    if {meanings[place][0] for place in varying} & {ROW, COLUMN}:
        return
    for last in range(len(words) - 1, 0, -1):
        pair = (last - 1, last)
        free = meanings[last][0] == UNKNOWN and meanings[last - 1][0] in (UNKNOWN, CAMERA) and not words[last]
        short = all(len(name.digits[place]) <= _PLACE_DIGITS for name in names for place in pair)
        if free and short and (varying & set(pair) or len(names) == 1):
            meanings[last - 1], meanings[last] = (ROW, BESIDE), (COLUMN, BESIDE)
            return


def _name_rest(
    words: Sequence[str], columns: Sequence[Sequence[int]], meanings: list[tuple[str, str]], varying: set[int]
) -> None:
    """Name the number that is left: the other of row and column, or the only number that differs."""
    places = [place for place in varying if meanings[place][0] in (ROW, COLUMN, CAMERA)]
    unknown = [place for place in sorted(varying) if meanings[place][0] == UNKNOWN]
    known = {meanings[place][0] for place in places}
    if known in ({ROW, CAMERA}, {COLUMN, CAMERA}) and len(places) == 2:  # "row0_cam3"
        camera, line = sorted(places, key=lambda place: meanings[place][0] != CAMERA)
        if len(set(columns[camera])) < len(columns[camera]):
            found = COLUMN if meanings[line][0] == ROW else ROW
            meanings[camera] = (found, f"cameras of each {meanings[line][0]}")
    if places and len(set(zip(*(columns[place] for place in places), strict=True))) == len(columns[0]):
        for place in unknown:
            if len(set(columns[place])) == len(columns[place]):
                meanings[place] = (CONSTANT, "it is another for each picture")
        return
    if len(unknown) != 1:
        return
    if known in ({ROW}, {COLUMN}) and words[unknown[0]] in ("", "/"):
        meanings[unknown[0]] = (COLUMN if known == {ROW} else ROW, f"the other number is the {known.pop()}")
    elif varying == {unknown[0]}:
        meanings[unknown[0]] = (CAMERA, "it is the only number that differs")


def _name_counter(columns: Sequence[Sequence[int]], meanings: list[tuple[str, str]], varying: set[int]) -> None:
    """Name a number without a word that goes on from line to line, so is no place in one: "0_0", "0_1", "1_2"."""
    for line, counter in permutations([place for place in varying if meanings[place][0] in (ROW, COLUMN)], 2):
        order = sorted(zip(columns[line], columns[counter], strict=True))
        goes_on = all(before < after for (_, before), (_, after) in pairwise(order))
        if goes_on and len(set(columns[line])) < len(order) and "word" not in meanings[counter][1]:
            meanings[counter] = (CAMERA, f"it goes on from {meanings[line][0]} to {meanings[line][0]}")
            meanings[line] = (CONSTANT, "it follows from the other")


_DATE_AND_TIME = re.compile(
    r"(?<!\d)(\d{4})[-_.]?(\d\d)[-_.]?(\d\d)(?:[-_ T.]*(\d\d)[-_.:]?(\d\d)[-_.:]?(\d\d)(?:[-_.]?\d{3})?)?(?!\d)"
)
_BETWEEN = re.compile(r"[-_.: ]")  # hours, minutes and seconds


def _moments(names: Sequence[Name]) -> dict[int, str]:
    """Find the numbers that are dates and times of day, with the reason."""
    found: set[int] | None = None
    for name in names:
        stem = "".join(x for pair in zip(name.texts, (*name.digits, ""), strict=True) for x in pair)
        ends = accumulate(len(text) + len(digits) for text, digits in zip(name.texts, name.digits, strict=False))
        spans = [(end - len(text), end) for end, text in zip(ends, name.digits, strict=True)]
        here = set()
        for match in _DATE_AND_TIME.finditer(stem):
            if _is_moment([int(part) for part in match.groups() if part]):
                here |= {k for k, (start, end) in enumerate(spans) if match.start() <= start and end <= match.end()}
        here |= {k for k, text in enumerate(name.digits) if len(text) >= _NO_PLACE}
        found = here if found is None else found & here
    found = found or set()
    return dict.fromkeys(found | _times_of_day(names, found), "it is a date or time")


def _times_of_day(names: Sequence[Name], dates: set[int]) -> set[int]:
    """Three numbers beside each other that may be hours, minutes and seconds, and are no full grid; two if dates are
    there, as well."""
    for count in (3, 2) if dates else (3,):
        for k in range(len(names[0].digits) - count + 1):
            numbers = [name.numbers[k : k + count] for name in names]
            texts = [text for name in names for text in name.texts[k + 1 : k + count]]
            short = all(len(text) == 2 for name in names for text in name.digits[k + 1 : k + count])
            hours = all(len(name.digits[k]) <= 2 and name.numbers[k] < 24 for name in names)
            *_, before, last = (set(column) for column in zip(*numbers, strict=True))
            full = len(before) > 1 and len(set(numbers)) == len(before) * len(last)
            fits = short and hours and all(map(_BETWEEN.fullmatch, texts)) and max(map(max, numbers)) < 60
            if fits and not full and len(last) > 1 and dates.isdisjoint(range(k, k + count)):
                return set(range(k, k + count))
    return set()


def _is_moment(parts: list[int]) -> bool:
    try:
        return _FIRST_YEAR <= datetime(*parts).year < _LAST_YEAR  # type: ignore[arg-type]
    except ValueError:
        return False


# --- patterns ---


def names_times(pattern: str) -> bool:
    """Tell whether a pattern names numbers that are times."""
    return any(_FIELDS.get(field.strip().lower()) == TIME for field in re.findall(r"\{([^{}]*)\}", pattern))


def matching(files: Iterable[Path], folder: Path, pattern: str) -> Naming:
    """Find the pictures that a pattern such as "cam{u}_frame{t}.png" names, with the numbers as it says.

    LightFieldError if it is none, or names no picture.
    """
    pieces = re.split(r"(\{[^{}]*\})", pattern)
    fields = [piece[1:-1].strip().lower() for piece in pieces[1::2]]
    if not fields or any(field not in _FIELDS for field in fields):
        wrong = next((f"{{{field}}}" for field in fields if field not in _FIELDS), repr(pattern))
        raise LightFieldError(
            f"pattern must name numbers as {{u}} (column), {{v}} (row), {{n}} (camera), {{t}}, {{date}}, {{time}} or "
            f"{{exposure}}, such as cam{{u}}_frame{{t}}.png; found {wrong}."
        )
    counted = [_FIELDS[field] for field in fields if _FIELDS[field] != TIME]
    if len(set(counted)) < len(counted) or {CAMERA, ROW} <= set(counted) or {CAMERA, COLUMN} <= set(counted):
        raise LightFieldError(
            f"pattern {pattern!r} says twice where a camera stood; name {{v}} and {{u}}, or {{n}}, once each, and put "
            "* for other numbers."
        )
    places = pieces[::2]
    text = f"([+-]?[0-9]+|{SIDE.pattern})".join(
        re.escape(piece).replace(r"\*", "[^/]*").replace(r"\?", "[^/]") for piece in places
    )
    expression = re.compile(text + r"(?:\.[^./]*)?", re.IGNORECASE)
    names = [
        Name(file, tuple(places), match.groups(), tuple(map(_counted, match.groups())))
        for file in files
        if (match := expression.fullmatch(file.relative_to(folder).as_posix()))
    ]
    if not names:
        raise LightFieldError(f"{folder} has no picture whose name is of the pattern {pattern!r}.")
    names.sort(key=lambda name: name.numbers)
    columns = zip(*(name.numbers for name in names), strict=True)
    counts = zip(fields, columns, strict=True)
    return Naming(tuple(names), tuple(Number(_FIELDS[field], "the pattern says so", found) for field, found in counts))
