"""Generated scenes: rays against a search along each ray in float64, and views against each other."""

from typing import Any

import numpy as np
import pytest
import warp as wp

from lfgpu.training import casting, scenes
from lfgpu.training.textures import draw_textures

pytestmark = pytest.mark.thorough

SIDE = 48


def drawn(seed: int, count: int = 6) -> scenes.Tables:
    return scenes.draw_scenes(count, SIDE, np.random.default_rng(seed), primitives=14, textures=12)


@pytest.fixture(scope="module")
def textures() -> Any:
    wp.init()
    return wp.array(draw_textures(12, np.random.default_rng(0)), dtype=wp.vec3f, device="cpu")


def cast(tables: scenes.Tables, textures: Any, offsets: Any, *, rays: int = 1) -> tuple[Any, Any]:
    """Cast views at offsets [n, 2] and the truth."""
    count, views = len(tables[0]), len(offsets)
    structs = casting.Shape, casting.Look, casting.Light
    shapes, looks, lights = (wp.array(t, dtype=s, device="cpu") for t, s in zip(tables, structs, strict=True))
    out = wp.zeros((count, views, SIDE, SIDE), dtype=wp.vec3f, device="cpu")
    truth = wp.zeros((count, SIDE, SIDE), dtype=float, device="cpu")
    places = wp.array(np.asarray(offsets, np.float32), dtype=wp.vec2f, device="cpu")
    gains = wp.array(np.ones((count, views), np.float32), device="cpu")
    shifts = wp.zeros((count, views), dtype=wp.vec2f, device="cpu")
    inputs = [shapes, looks, lights, textures, places, gains, shifts, rays, 0, 1]
    wp.launch(casting.views_kernel, dim=out.shape, inputs=inputs, outputs=[out], device="cpu")
    wp.launch(casting.truth_kernel, dim=truth.shape, inputs=[shapes, textures], outputs=[truth], device="cpu")
    return out.numpy(), truth.numpy()


def is_inside(shape: Any, x: Any, y: Any, d: Any) -> Any:
    """Say which points lie in a solid, or behind a sheet, from what its fields mean."""
    r = np.stack(np.broadcast_arrays(x - shape["centre"][0], y - shape["centre"][1], d - shape["centre"][2]))
    c, s = shape["axis"]
    behind = r[2] - shape["slope"][0] * r[0] - shape["slope"][1] * r[1]
    u, v = r[0] * c + r[1] * s, r[1] * c - r[0] * s
    if shape["kind"] == casting.SHEET:
        inside = np.ones_like(u, bool)
        if shape["mask"] == casting.RECTANGLE:
            inside = (np.abs(u) < shape["size"][0]) & (np.abs(v) < shape["size"][1])
        if shape["mask"] == casting.ELLIPSE:
            inside = (u / shape["size"][0]) ** 2 + (v / shape["size"][1]) ** 2 < 1
        return (behind <= 0) & inside
    a = u / shape["size"][0] + shape["tilt"][0] * r[2]
    b = v / shape["size"][1] + shape["tilt"][1] * r[2]
    w = behind / shape["size"][2]
    if shape["kind"] == casting.QUADRIC:
        end = np.abs(b) <= 1 if shape["roundness"] < 0.5 else True
        return (a**2 + shape["roundness"] * b**2 + w**2 <= 1) & end
    return (np.abs(a) <= 1) & (np.abs(b) <= 1) & (np.abs(w) <= 1)


@pytest.mark.parametrize("kind", [casting.SHEET, casting.QUADRIC, casting.BOX])
def test_the_truth_is_the_first_point_along_each_ray(kind: int, textures: Any) -> None:
    """March along rays in small steps, from the nearest disparity on; kernels solve for roots instead."""
    rng = np.random.default_rng(kind)
    found = 0
    for seed in range(14):
        shapes, looks, lights = drawn(100 * kind + seed, 1)
        keep = (shapes["kind"][0] == kind) & (shapes["centre"][0, :, 2] > -1e5) & (shapes["relief"][0] == 0)
        keep &= shapes["mask"][0] <= casting.ELLIPSE
        shapes = shapes[:, keep]
        if not shapes.size:
            continue
        truth = cast((shapes, looks[:, keep], lights), textures, [(0, 0)])[1][0]
        seen = np.argwhere(np.isfinite(truth))
        places = [*rng.integers(0, SIDE, (5, 2)), *seen[rng.permutation(len(seen))[:10]]]
        near = float((shapes["centre"][..., 2] + np.minimum(shapes["reach"][..., 2], 60)).max())
        d = np.linspace(near, near - 100, 50001)
        for y, x in places:
            inside = np.zeros(len(d), bool)
            for shape in shapes[0]:
                entered = is_inside(shape, float(x), float(y), d)
                # A sheet is met where the ray crosses it, not behind it.
                inside |= entered & ~np.roll(entered, 1) if kind == casting.SHEET else entered
            inside[0] = False
            if inside.any():
                expected = d[inside.argmax()]
                assert truth[y, x] == pytest.approx(expected, abs=1e-2)
                found += 1
            elif not np.isnan(truth[y, x]):
                assert truth[y, x] < d[-1] + 1 or truth[y, x] > near - 1e-2
    assert found > 20


def test_views_show_what_the_truth_says(textures: Any) -> None:
    """Pixels of the reference that a view shows have the same colour there, if the scene is matt and without noise."""
    tables = drawn(7)
    for name in ("gloss", "mirror"):
        tables[1][name] = 0
    for name in ("read", "shot", "aperture", "vignetting", "shadow"):
        tables[2][name] = 0
    tables[2]["levels"] = 65535
    offsets = np.array([(0, 0), (1, 0), (0, -1), (-0.5, 0.7)])
    views, truth = cast(tables, textures, offsets, rays=3)
    agreeing = []
    for n in range(1, len(offsets)):
        for scene in range(len(truth)):
            d = np.rint(2 * truth[scene]) / 2  # those whose place is a whole pixel in that view
            rows, columns = np.mgrid[:SIDE, :SIDE]
            x, y = columns - d * offsets[n, 0], rows - d * offsets[n, 1]
            exact = (np.abs(truth[scene] - d) < 0.02) & (x == np.rint(x)) & (y == np.rint(y))
            exact &= (x >= 0) & (y >= 0) & (x < SIDE) & (y < SIDE)
            there = views[scene, n, y[exact].astype(int), x[exact].astype(int)]
            agreeing.extend(np.abs(there - views[scene, 0][exact]).max(-1))
    assert len(agreeing) > 300
    assert np.mean(np.array(agreeing) < 0.02) > 0.6  # the others are hidden, or at an outline
    assert np.median(agreeing) < 0.004


def test_the_nearest_of_two_sheets_wins(textures: Any) -> None:
    shapes, looks, lights = (table[:1] for table in drawn(3))
    shapes = shapes[:, :2].copy()
    shapes[:] = np.zeros(1, shapes.dtype)
    shapes["size"], shapes["reach"], shapes["axis"] = 1.0, 1e7, (1, 0)
    shapes["centre"][0, :, 2] = 3.0, -2.0
    assert (cast((shapes, looks[:, :2], lights), textures, [(0, 0)])[1] == 3.0).all()


def test_scenes_are_the_same_for_the_same_seed() -> None:
    for first, again in zip(drawn(5), drawn(5), strict=True):
        assert first.tobytes() == again.tobytes()
    assert drawn(5)[0].tobytes() != drawn(6)[0].tobytes()


def test_arrays_are_scaled_to_their_farthest_view() -> None:
    for seed in range(60):
        offsets = scenes.draw_array(np.random.default_rng(seed))
        assert len(offsets) >= 2
        assert np.abs(offsets).max() == pytest.approx(1)
        assert np.abs(offsets).max(1).min() > 0


def test_some_scenes_are_matt_textured_and_well_lit() -> None:
    """The others, and all shapes, are what they are without such scenes."""
    given = 40, SIDE
    shapes, looks, lights = scenes.draw_scenes(*given, np.random.default_rng(5), matt=0.5)
    whole, _, _ = usual = scenes.draw_scenes(*given, np.random.default_rng(5))
    assert (shapes == whole).all()
    shines = np.stack([looks[name] for name in ("gloss", "mirror", "glow")]).any((0, 2))
    matt = ~shines & (looks["contrast"].min(1) >= 0.15) & (lights["exposure"] >= 0.7)
    same = (looks == usual[1]).all(1) & (lights == usual[2])
    assert 10 <= matt.sum() <= 30
    assert (matt | same).all()
