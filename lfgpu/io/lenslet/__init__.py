"""Raw captures of lenslet cameras as light fields: what is one, and its views.

`capture` reads files of every kind; `microlenses` finds the grid, `vignetting` the light that each pixel gets, `bayer`
its colours; `resampling` makes views; `decode` is all of it in order, and writes views.
"""

from lfgpu.io.lenslet.entry import inside, read_lenslet, recognise
