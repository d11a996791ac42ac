"""Light fields, maps and masks from and to files."""

from lfgpu.io.atomic import atomic_folder, atomic_write, check_no_inputs, check_writable
from lfgpu.io.description import write_description
from lfgpu.io.formats import FORMATS, Format, inside, read, recognise
from lfgpu.io.hci import write_hci
from lfgpu.io.images import read_mask
from lfgpu.io.map_formats import (
    DEPTH_FILE,
    DISPARITY_FILE,
    MAP_FORMATS,
    REPORT_FILE,
    RESULT_FILE,
    VIEWS_FILE,
    MapFormat,
    holds_map,
    load,
    one_map,
    read_map,
    result_in,
    save,
    writable_format,
)
from lfgpu.io.pfm import write_pfm

__all__ = [
    "DEPTH_FILE",
    "DISPARITY_FILE",
    "FORMATS",
    "MAP_FORMATS",
    "REPORT_FILE",
    "RESULT_FILE",
    "VIEWS_FILE",
    "Format",
    "MapFormat",
    "atomic_folder",
    "atomic_write",
    "check_no_inputs",
    "check_writable",
    "holds_map",
    "inside",
    "load",
    "one_map",
    "read",
    "read_map",
    "read_mask",
    "recognise",
    "result_in",
    "save",
    "writable_format",
    "write_description",
    "write_hci",
    "write_pfm",
]
