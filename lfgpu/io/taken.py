"""Sentences about what was taken for what when a light field was read: places, pictures, lengths."""

from dataclasses import replace

from lfgpu.data import LightField
from lfgpu.data.geometry import UNITS, Geometry
from lfgpu.errors import LightFieldError
from lfgpu.io.exr import CUT, LINEAR
from lfgpu.io.images import INVERTED, TURNED


def told(light_field: LightField, name: str, *, order: str, transpose: bool, flip: str) -> LightField:
    """Complete `reading` of a light field that was read as the format `name`, with the options that were given."""
    reading = light_field.reading
    places = reading.places or f"rows and columns of views as the format {name} has them"
    if order != "row-major":
        places += f"; stored in {order} order, as told"
    if transpose or flip:
        ways = [*(["rows and columns swapped"] if transpose else []), *([f"turned round along {flip}"] if flip else [])]
        places += f"; {', '.join(ways)}, as told"
    notes, valid = light_field.notes, light_field.valid
    changes = [text for text in (TURNED, INVERTED, LINEAR, CUT) if any(text[1:] in note for note in notes)]
    seen = "all pixels are valid"
    if valid is not None:
        seen = f"{100 * float(valid.mean()):.1f} % of the pixels are valid, as masks or dark corners say"
    pictures = ", ".join([*(changes or ["oriented as they are stored"]), seen])
    none = "none: there is disparity only"
    lengths = reading.lengths or (none if light_field.geometry is None else "metres, from the files")
    done = replace(reading, places=places, pictures=pictures, lengths=lengths, transpose=transpose, flip=flip)
    return replace(light_field, reading=done)


def in_unit(light_field: LightField, unit: str | None) -> LightField:
    """Scale the lengths of files that do not say their unit; without `unit` they are metres, doubted if implausible."""
    geometry = light_field.geometry
    if geometry is None:
        return light_field
    if unit is None:
        if plausible(geometry):
            return light_field
        note = f"Neighbouring cameras would stand {geometry.baseline_m:.4g} m apart: say the unit with --unit mm or cm."
        return replace(light_field, notes=(*light_field.notes, note))
    scale = UNITS[unit]
    geometry = replace(
        geometry, baseline_m=scale * geometry.baseline_m, focus_distance_m=scale * geometry.focus_distance_m
    )
    reading = replace(light_field.reading, lengths=f"lengths of the file are {unit}, as told")
    notes = tuple(note for note in light_field.notes if not note.startswith("Lengths have no unit"))
    return replace(light_field, geometry=geometry, reading=reading, notes=notes)


def plausible(geometry: Geometry) -> bool:
    """Tell whether neighbouring cameras stand as far apart as cameras do; lengths are of another unit otherwise."""
    return 1e-5 <= geometry.baseline_m <= 2.0


def check_unit(unit: object) -> None:
    """Raise LightFieldError unless `unit` is None or the name of a unit of lengths."""
    if unit is not None and unit not in UNITS:
        raise LightFieldError(f"unit must be one of {', '.join(UNITS)}, not {unit!r:.60}.")
