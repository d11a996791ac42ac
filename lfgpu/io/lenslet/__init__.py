"""Raw captures of lenslet cameras as light fields: what is one, its views, and writing them.

`capture` reads files of every kind, `container` the sections of Lytro's; `microlenses` finds the grid, `vignetting` the
light that each pixel gets, `bayer` its colours; `resampling` makes views; `decode` is all of it in order.
"""

from lfgpu.io.lenslet.entry import read_lenslet, recognise
from lfgpu.io.lenslet.written import write_decoded

__all__ = ["read_lenslet", "recognise", "write_decoded"]
