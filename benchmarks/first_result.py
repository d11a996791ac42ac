"""A first result in a fresh process, from import to end: `python -m benchmarks.first_result SCENE BACKEND DEVICE`."""

import sys
from pathlib import Path

from benchmarks import scene
from lfgpu import estimate_depth
from lfgpu._backends import backend_named

estimate_depth(scene.load(Path(sys.argv[1])), backend=backend_named(sys.argv[2]), device=sys.argv[3])
