"""`python -m lfgpu` is `lfgpu`."""

from lfgpu.cli import main

main()
