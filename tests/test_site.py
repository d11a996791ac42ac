"""The site's own parts: types in the lists of parameters, the order of search results, the film."""

import importlib.util
import json
import shutil
import subprocess
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

import lfgpu
from lfgpu import scenes
from lfgpu.methods.matching.method import Matching
from lfgpu.methods.synthesis.method import Synthesis

DOCS = Path(__file__).parents[1] / "docs"


def module(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def listed(thing: object) -> list[str]:
    pytest.importorskip("sphinx", reason="Sphinx is not installed: pip install 'lfgpu[docs]'")
    lines = [line.removeprefix("    ") for line in (thing.__doc__ or "").splitlines()]
    module(DOCS / "_ext" / "typed.py").add_types(None, "", "", thing, None, lines)
    return lines


def test_parameters_are_listed_with_their_types_as_the_source_names_them() -> None:
    assert "config : Config | PresetName | None, default `None`" in listed(lfgpu.estimate_depth)
    assert "lf : LightField" in listed(lfgpu.estimate_depth)
    assert "valid : NDArray[np.bool] | None, default `None`" in listed(lfgpu.LightField)  # bool_ would be a link
    assert "backend, device" in listed(lfgpu.Renderer), "types of parameters that stand together differ"


def test_benchmarks_come_after_guides_in_searches(tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node, which runs JavaScript")
    pages = ["made/measured", "measured/index", "guides/index", "made/api/lfgpu.explain", "confidence"]
    script = (DOCS / "_static" / "scorer.js").read_text() + (
        f"\nconsole.log(JSON.stringify({json.dumps(pages)}.map(page => Scorer.score([page, '', '', '', 30]))));"
    )
    done = subprocess.run([node, "-e", script], capture_output=True, text=True, check=True)
    scores = json.loads(done.stdout)
    assert max(scores[:2]) < min(scores[2:]) - 30


@pytest.mark.parametrize("method", [Matching, Synthesis])
def test_stages_have_the_names_of_the_code(method: type[Matching] | type[Synthesis]) -> None:
    page = " ".join((DOCS / "how" / f"{method.__name__.lower()}.md").read_text().split())
    names = [f"`{stage.name}`" + ("" if stage.name == stage.label else f" ({stage.label})") for stage in method.STAGES]
    assert f"after each stage: {', '.join(names[:-1])} and {names[-1]}." in page


@pytest.mark.thorough
def test_films_are_small_and_the_script_draws_one(monkeypatch: pytest.MonkeyPatch) -> None:
    film = module(DOCS / "film.py")
    assert film.FILM.stat().st_size < 600_000
    assert (DOCS / "viewer.webp").stat().st_size < 600_000
    with Image.open(film.FILM) as committed:
        assert committed.n_frames > 2 * film.FRAMES - 10  # equal frames in a row are one
    monkeypatch.setattr(film, "FRAMES", 2)
    drawn = film.frames(scenes.make("boxes", grid=(9, 9), size=(24, 32)))
    assert [frame.size for frame in drawn] == [(32 * 2 + 8, 24)] * 4
    assert len({frame.tobytes() for frame in drawn}) > 2
