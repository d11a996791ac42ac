"""docs/extending.md, followed to the letter: a format and a method in a copy of lfgpu, and then used.

The third method goes through everything that runs methods, none of which names it.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lfgpu import scenes
from lfgpu.io import read_map, write_hci

pytestmark = pytest.mark.thorough

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "extending.md").read_text(encoding="utf-8")
PLACE = re.compile(r"# (?P<file>\S+\.py)(: (at the end of (?P<table>\w+)|(?P<import>an import)))?\n")
RANGE = (-1.0, 3.0)
PLANE = 1.0  # in the middle of that


def follow(page: str, copy: Path) -> list[str]:
    """Do to a copy what the blocks of code of a page say; what was done to which files."""
    done = []
    for block in re.findall(r"```python\n(.*?)```", page, re.DOTALL):
        place = PLACE.match(block)
        assert place is not None, f"where does this go?\n{block}"
        path, text = copy / place["file"], block[place.end() :]
        if place["table"]:
            before = path.read_text()
            table = re.search(rf"^{place['table']}\b[^\n]*[{{(]\n.*?(?=^[}})])", before, re.DOTALL | re.MULTILINE)
            assert table is not None, f"{path} has no table {place['table']}"
            path.write_text(before[: table.end()] + text + before[table.end() :])
        elif place["import"]:
            before = path.read_text()
            path.write_text(before.replace("\nfrom lfgpu.", f"\n{text}from lfgpu.", 1))
        else:
            assert not path.exists(), path
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        done.append(block[: place.end()].strip())
    return done


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of lfgpu to which the page was applied."""
    folder = tmp_path_factory.mktemp("copy")
    for name in ("lfgpu", "kernels"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"), symlinks=True)
    assert len(follow(PAGE, folder)) == 20
    return folder


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two light fields."""
    folder = tmp_path_factory.mktemp("recorded")
    for seed in range(2):
        lf = scenes.make("relief", grid=(3, 3), size=(40, 48), disparity_range=(-0.5, 0.5), seed=seed)
        write_hci(lf, folder / f"scene_{seed}")
    return folder


def run(copy: Path, cwd: Path, *command: str | Path, code: int = 0) -> str:
    """Return the output of Python code with the copy in place of lfgpu."""
    done = subprocess.run(
        [sys.executable, *command], cwd=cwd, env={**os.environ, "PYTHONPATH": str(copy)}, capture_output=True, text=True
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def lfgpu(copy: Path, cwd: Path, *arguments: str | Path, code: int = 0) -> str:
    return " ".join(run(copy, cwd, "-m", "lfgpu", *arguments, code=code).split())


BOUNDS = f"--disparity-range={RANGE[0]},{RANGE[1]}"

IN_PYTHON = """
import sys
from pathlib import Path

import numpy as np

import lfgpu
from lfgpu.methods import METHODS, PRESETS, method_of
from lfgpu.methods.measured import Measured
from lfgpu.viewer.solving import Request, Solver

assert Path(lfgpu.__file__).is_relative_to(sys.argv[1]), lfgpu.__file__
lf, bounds = lfgpu.read(Path(sys.argv[2]) / "scene_0"), (-1.0, 3.0)
assert list(METHODS)[-1] == list(PRESETS)[-1] == "plane"

seen = []
result = lfgpu.estimate_depth(lf, config="plane", disparity_range=bounds, on_progress=lambda *said: seen.append(said))
assert (result.disparity == 1.0).all() and (result.confidence == 0.5).all()
assert seen == [("place", 0, 0.0), ("place", 1, 0.0)], seen
assert list(result.stages) == ["place"] and {"place", "total"} <= set(result.timings)

# tiles
method = method_of("plane")
needed = method.footprint(lf.layout, Measured(bounds), on_gpu=False)
memory = needed.bytes(40, 40) + lf.views.nbytes + 4 * 8 * 40 * 48
tiled = lfgpu.estimate_depth(lf, config="plane", disparity_range=bounds, max_memory=memory, device="cpu")
assert tiled.status.startswith("2 tiles"), tiled.status
assert np.array_equal(tiled.disparity, result.disparity)

# all views
views = lfgpu.estimate_all_views(lf, config="plane", disparity_range=bounds, device="cpu")
assert views.disparities.shape == (9, 40, 48)

# saving and loading
changed = PRESETS["plane"].with_values({"plane.share": 0.25})
lfgpu.estimate_depth(lf, config=changed, disparity_range=bounds).save("result.npz")
loaded = lfgpu.load("result.npz")
assert loaded.config == changed and (loaded.disparity == 0.0).all()

# the viewer
said, results = [], []
solver = Solver(said.append, lambda request, found: results.append(found))
assert solver.start(Request(lf, PRESETS["plane"], bounds))
solver._thread.join()
texts = [progress.text for progress in said]
assert any(text.startswith("placing the plane, iteration 1") for text in texts), texts
shares = [progress.share for progress in said]
assert shares == sorted(shares) and shares[-1] == 100.0, shares
assert (results[0].disparity == 1.0).all()

try:
    lfgpu.DepthStream(lf, config="plane", disparity_range=bounds)
except lfgpu.LightFieldError as error:
    assert "plane cannot" in str(error), error
else:
    raise AssertionError("a stream ran")
print("all of it")
"""


def test_a_third_method_goes_through_the_house(copy: Path, recorded: Path, tmp_path: Path) -> None:
    assert run(copy, tmp_path, "-c", IN_PYTHON, copy, recorded).strip() == "all of it"


def test_a_third_method_on_the_command_line(copy: Path, recorded: Path, tmp_path: Path) -> None:
    one = recorded / "scene_0"
    said = lfgpu(copy, tmp_path, "depth", one, "-o", "out", "--preset", "plane", BOUNDS, "--report")
    assert re.search(r"\bplace \d", said)  # how long each stage took
    assert (read_map(tmp_path / "out" / "disparity.pfm") == PLANE).all()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "plane.share" in page

    assert "plane: in the middle of the range" in lfgpu(copy, tmp_path, "depth", "--help").replace("│ ", "")
    assert "plane.share\t0.5\t0 to 1" in run(copy, tmp_path, "-m", "lfgpu", "parameters", "--preset", "plane")

    settings = ("--set", "plane.share=2")
    said = lfgpu(copy, tmp_path, "depth", one, "-o", "no", "--preset", "plane", *settings, code=1)
    assert "share must be from 0 to 1, not 2." in said
    said = lfgpu(copy, tmp_path, "depth", one, "-o", "no", "--preset", "fast", "--set", "plane.share=0.2", code=1)
    assert "belongs to the method plane" in said
    said = lfgpu(copy, tmp_path, "depth", one, "-o", "no", "--preset", "planes", code=1)
    assert "accurate, fast, learned, surest, paper, paper-exact, plane" in said
    assert not (tmp_path / "no").exists()


def test_a_third_method_in_a_batch(copy: Path, recorded: Path, tmp_path: Path) -> None:
    """In other processes."""
    pytest.importorskip("distributed", reason="a batch needs Dask: pip install 'lfgpu[batch]'")
    lfgpu(copy, tmp_path, "batch", recorded, "-o", "out", "--preset", "plane", BOUNDS, "--device", "cpu", "-q")
    found = sorted((tmp_path / "out").rglob("disparity.pfm"))
    assert len(found) == 2
    for path in found:
        assert (read_map(path) == PLANE).all()


IN_MATCHING = """
import sys
from pathlib import Path

import numpy as np

import lfgpu
from lfgpu import scenes
from lfgpu.methods import PRESETS
from lfgpu.methods.matching.passes import TABLES

assert Path(lfgpu.__file__).is_relative_to(sys.argv[1]), lfgpu.__file__
lf, fast = scenes.make("boxes", grid=(5, 5), size=(64, 72)), PRESETS["fast"].with_values({"sweep.views": "star"})
names = ["matching", "two costs", "diagonals", "least cost"]
assert list(TABLES) == ["matching", "learned", "both", *names[1:]]
results = {}
for name in names:
    config = fast.with_tuning({"passes": name})
    results[name] = lfgpu.estimate_depth(lf, config=config, disparity_range=(-1.6, 1.6), device="cpu")
    scores = lfgpu.evaluate(results[name], lf.truth)
    print(name, scores.mse_100)
    assert scores.mse_100 < 40
for name in names[1:]:
    assert np.array_equal(results[name].stages["sweep"], results["matching"].stages["sweep"])
    assert not np.array_equal(results[name].stages["resweep"], results["matching"].stages["resweep"])
assert (results["least cost"].confidence <= 0.5).all()
"""


def test_a_cost_a_view_rule_and_an_aggregation_are_rows_of_tables(copy: Path, tmp_path: Path) -> None:
    run(copy, tmp_path, "-c", IN_MATCHING, copy)


def test_a_new_format_is_read(copy: Path, tmp_path: Path) -> None:
    lf = scenes.make("boxes", grid=(1, 5), size=(32, 40))
    Image.fromarray(np.concatenate(list(lf.views), axis=1)).save(tmp_path / "row.strip.png")
    lf.views.tofile(tmp_path / "views.raw")
    said = lfgpu(copy, tmp_path, "info", "row.strip.png", "--grid", "1x5")
    assert "it is named .strip.png" in said
    assert "1 x 5" in said
    said = lfgpu(copy, tmp_path, "info", "row.strip.png", "--grid", "1x3", code=1)
    assert "row.strip.png is 200 pixels wide; give the number of views" in said
    same = (
        "import lfgpu, numpy as np; lf = lfgpu.read('row.strip.png', grid=(1, 5)); "
        "print(np.array_equal(lf.views.ravel(), np.fromfile('views.raw', np.uint8)), json.dumps(lf.positions.tolist()))"
    )
    first, positions = run(copy, tmp_path, "-c", f"import json; {same}").strip().split(" ", 1)
    assert first == "True"
    assert json.loads(positions) == lf.positions.tolist()
