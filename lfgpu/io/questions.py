"""Questions about numbers in names of pictures: sentences with the options that answer them."""

from pathlib import Path

from lfgpu.io import parallax
from lfgpu.io.naming import BESIDE, CAMERA, COLUMN, EXPOSURE, ROW, SIDE, TIME, UNKNOWN, Naming, Number

LOOKED_AT = 64  # pictures that are compared to see how their cameras stood


def rivals(path: Path, naming: Naming, other: Path, *, alike: bool) -> str:
    """Ask which of two kinds of pictures are the views; `alike` says that both have the same numbers."""
    mine = naming.files[0]
    what = "folders" if mine.parent != other.parent else "names"
    sides = {SIDE.sub("{u}", str(file.relative_to(path)), count=1) for file in (mine, other)}
    stereo = SIDE.sub("{u}", naming.pattern(dict.fromkeys(range(len(naming.numbers)), "t")), count=1)
    advice = f'say --pattern "{stereo}"' if len(sides) == 1 else "count the cameras in them, such as cam0 and cam1"
    times = f" If these {what} are cameras and the numbers times, {advice}." * alike
    if what == "folders":
        folders = ", ".join(file.relative_to(path).parts[0] for file in (mine, other))
        return f"{path} has several folders with numbered images ({folders}); give one.{times}"
    unlike = [a + b for a, b in zip(mine.name, other.name, strict=False) if a != b]
    by_letter = len(mine.name) == len(other.name) and len(unlike) == 1 and unlike[0].isalpha()
    if alike and by_letter and len(sides) > 1:
        return (
            f"{path} has images whose names differ by a letter, such as {mine.name} and {other.name}: if letters count "
            "rows, columns or cameras, put numbers for them, such as row1_col1 or cam1_frame1; if they are kinds of "
            f'pictures, say which are the views with --pattern "{naming.pattern()}" (pattern= in Python).'
        )
    return (
        f"{path} has images named in different ways: {mine.name} and {other.name}; say which are the views with "
        f'--pattern "{naming.pattern()}" (pattern= in Python), or move what is no view elsewhere.{times}'
    )


def question(path: Path, naming: Naming) -> str | None:
    """Ask for what names cannot tell: a sentence with the option that settles it; None if all is clear."""
    unknown, cameras, times = naming.of(UNKNOWN), naming.of(CAMERA), naming.of(TIME)
    places = [*naming.of(ROW), *naming.of(COLUMN), *cameras]
    moving = [number for number in places if number.varies]
    unclear = len(cameras) > 1 or len(naming.of(ROW)) > 1 or len(naming.of(COLUMN)) > 1
    unclear |= bool(cameras) and any(number.varies for number in places[: -len(cameras)])
    first = naming.files[0]
    at = {number.meaning: place for place, number in enumerate(naming.numbers) if number.varies}
    if naming.of(EXPOSURE) and len(naming.places) > len(set(naming.places)):
        return (
            f"{path} has several exposures of each camera, such as {first.name}: choose one with "
            f'--pattern "{naming.pattern({at[EXPOSURE]: ""})}" (pattern= in Python).'
        )
    folders = [place for place, text in enumerate(naming.names[0].texts[1:]) if "/" in text]
    if unknown and folders and naming.numbers[folders[-1]].varies:
        names = sorted({file.relative_to(path).parts[0] for file in naming.files})
        listed_names = ", ".join(names[:4]) + (", ..." if len(names) > 4 else "")
        at_folder, inside = folders[-1], [k for k, n in enumerate(naming.numbers) if n.varies and k > folders[-1]]
        if ROW in at and COLUMN in at:
            proposed = f'"{naming.pattern({at_folder: "t"})}" for times'
        else:
            last = inside[0] if inside else at_folder
            are_cameras = at.get(CAMERA) == at_folder or at.get(TIME) == last
            camera, other = (at_folder, last) if are_cameras else (last, at_folder)
            proposed = (
                f'"{naming.pattern({at_folder: "v", last: "u"})}" for rows and columns or '
                f'"{naming.pattern({camera: "u", other: "t"})}" for cameras and times'
            )
        return (
            f"{path} has several folders with numbered images ({listed_names}); give one, or say what the numbers "
            f"count with --pattern, such as {proposed} (pattern= in Python)."
        )
    if unknown or unclear:
        return (
            f"{path}: it cannot be known what the numbers in names such as {first.name} count; say it with "
            f'--pattern "{naming.pattern()}" (pattern= in Python), where {{u}} is a column, {{v}} a row, '
            "{n} a camera and {t} a time in place of {?}."
        )
    if times and not moving:
        if (
            all("word" in number.why for number in times)
            and parallax.line(parallax.consecutive(naming.files[:LOOKED_AT])) == "row"
        ):
            return None
        if all("pattern" in number.why for number in times):
            return None
        words = iter(["date", "time"] if all("word" not in n.why for n in times) else [])
        of_time = [place for place, number in enumerate(naming.numbers) if number.meaning == TIME]
        named = naming.pattern({place: next(words, "t") for place in of_time})
        return (
            f"{path}: the numbers in names such as {first.name} are times, which say nothing of where the camera "
            f'stood; if it moved to the right in equal steps, say --pattern "{named}" (pattern= in Python), and '
            "--grid ROWSxCOLUMNS if it moved over a grid."
        )
    return None


def beside(path: Path, naming: Naming, row: int, column: int) -> str:
    """Ask what two numbers beside each other count, which begin at `row` and at `column`."""
    at = [place for place, number in enumerate(naming.numbers) if number.why == BESIDE]
    times, first = naming.pattern({at[0]: "n", at[1]: "t"}), min(row, column)
    return (
        f"{path} lacks views such as row {first} column {first} if the numbers in names such as "
        f"{naming.files[0].name} are rows and columns, which count from {row} and from {column}: add them, or pass "
        f'allow_missing=True (--allow-missing), or say --pattern "{naming.pattern()}" if there are no others. If they '
        f'are cameras and times, say --pattern "{times}" (pattern= in Python).'
    )


def joined(path: Path, naming: Naming, number: Number) -> str | None:
    """Ask whether the digits of one number are a row and a column: "img11" to "img55"; None if they make no grid."""
    at = next(place for place, other in enumerate(naming.numbers) if other is number)
    digits = {name.digits[at] for name in naming.names}
    rows, columns = {text[0] for text in digits}, {text[-1] for text in digits}
    two = all(len(text) == 2 for text in digits) and min(number.values) >= 0
    if "pattern" in number.why or not two or min(len(rows), len(columns)) < 2 or len(digits) < len(rows) * len(columns):
        return None
    return (
        f"{path} has images numbered from {min(digits)} to {max(digits)} with gaps, whose digits make a full grid of "
        f"{len(rows)} x {len(columns)}: if these are row and column, say --pattern "
        f'"{naming.pattern({at: "v}{u"})}" (pattern= in Python); if they are a row that lacks views, say --pattern '
        f'"{naming.pattern({at: "n"})}" and --allow-missing.'
    )
