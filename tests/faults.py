"""Faults that tests once did not notice, and the test that does now: `python tests/faults.py` injects each in a copy.

It prints for each whether its test fails, and exits with 1 if one passes. It takes some minutes.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from lfgpu.threads import get_threads

ROOT = Path(__file__).parents[1]
_COPIED = ("lfgpu", "kernels", "benchmarks", "tests", "pyproject.toml", "README.md", "docs")


@dataclass(frozen=True)
class Fault:
    """A piece of a file, what it is changed to, and the tests that must fail."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...]


_PRINTED = "tests/test_printed_equations.py"
_MATRIX = "tests/kernels/test_matrix.py"
_GPU = "tests/kernels/test_gpu_kernels.py"
_FORMULAS = "tests/test_formulas.py"
FAULTS = (
    Fault(
        "λ doubled",
        "lfgpu/methods/synthesis/energy.py",
        "self._model, self._prior, self._smoothness, self._start = model, prior, smoothness, start",
        "self._model, self._prior, self._smoothness, self._start = model, prior, 2 * smoothness, start",
        (_PRINTED, "-k", "lambda and reference"),
    ),
    Fault(
        "one of 81 views dropped from the data term on a CPU",
        "kernels/warp/splat.py",
        "            for n in range(first, last):\n                pair",
        "            for n in range(first, min(last, 80)):\n                pair",
        (_MATRIX, "-k", "data_term-views-of-a-benchmark and warp and equals"),
    ),
    Fault(
        "τ ten times as large along the views",
        "lfgpu/methods/structure_tensor.py",
        "along = _gaussian(places, config.outer_scale)",
        "along = _gaussian(places, 10 * config.outer_scale)",
        (_PRINTED, "-k", "printed and reference"),
    ),
    Fault(
        "the column's tensor with the row's spacing",
        "lfgpu/methods/structure_tensor.py",
        "self._spacing = _spacing(offsets)",
        "self._spacing = _spacing(lf.offsets[[int(index) for index in lf.row()], 0])",
        (_PRINTED, "-k", "printed and reference"),
    ),
    Fault(
        "the share of a shear in half precision",
        "kernels/warp/structure_tensor.py",
        "share = shift - whole",
        "share = float(wp.float16(shift - whole))",
        (_MATRIX, "-k", "structure_tensor-shear-of-many and warp and equals"),
    ),
    Fault(
        "Armijo's constant",
        "kernels/warp/lbfgs.py",
        "_DECREASE = 1e-4",
        "_DECREASE = 2e-4",
        (_MATRIX, "-k", "sufficient_decrease and warp"),
    ),
    Fault(
        "rings of fewer rows than a slice of views begins with",
        "kernels/warp/smoothing.py",
        "_RING = 16",
        "_RING = 8",
        (_MATRIX, "-k", "smooth_views-work-for-several and warp and equals"),
    ),
    Fault(
        "the mask of a pixel in the place of its neighbours'",
        "kernels/warp/native/smoothing.h",
        "some(count + dx) / (unlike * unlike)",
        "some(count) / (unlike * unlike)",
        (_MATRIX, "-k", "smooth_views-few-valid and warp and equals"),
    ),
    Fault(
        "the likeness of pixels that are not valid",
        "kernels/warp/native/smoothing.h",
        "likeness = unit * some(known + x)",
        "likeness = (Some)(unit)",
        (_MATRIX, "-k", "smooth_views-few-valid and warp and equals"),
    ),
    Fault(
        "one row less above a pixel than below it",
        "kernels/taichi/smoothing.py",
        "range(ti.max(-SMOOTHING_REACH, -y),",
        "range(ti.max(1 - SMOOTHING_REACH, -y),",
        (_MATRIX, "-k", "smooth_views-one-pixel-wide and taichi and equals"),
    ),
    Fault(
        "reduced costs half a pixel beside their place along rows",
        "kernels/warp/native/cost_volume.h",
        "const float away = (j + 0.5f) / REDUCTION - 0.5f;",
        "const float away = (float)j / REDUCTION - 0.5f;",
        (_MATRIX, "-k", "add_reduced and left-over and warp and equals"),
    ),
    Fault(
        "refocusing with the sign of dv turned",
        "lfgpu/viz/refocusing.py",
        "move = tuple(-disparity * lf.offsets[n, axis] for axis in (1, 0))",
        "move = tuple((1 if axis else -1) * disparity * lf.offsets[n, axis] for axis in (1, 0))",
        ("tests/test_render.py", "-k", "shifts_each_view"),
    ),
    Fault(
        "taps in the row before a GPU's tile",
        "kernels/warp/native/data_term.cuh",
        "y0 = tile_y * tile_height - 1;",
        "y0 = tile_y * tile_height;",
        (_GPU, "-k", "data_term and equals"),
    ),
    Fault(
        "strips beyond the first list of a GPU's tile",
        "kernels/warp/native/data_term.cuh",
        "for (int first = 0; first < candidates; first += LIST) {\n        if (first)",
        "for (int first = 0; first < min(candidates, LIST); first += LIST) {\n        if (first)",
        (_GPU, "-k", "data_term and equals"),
    ),
    Fault(
        "the mask of the data term on a GPU",
        "kernels/warp/gpu_data_term.py",
        "if not valid or valid[i] != 0.0:",
        "if not valid or valid[i] != 2.0:",
        (_GPU, "-k", "data_term and equals"),
    ),
    Fault(
        "a sweep's rows below the view on a GPU",
        "kernels/warp/native/plane_sweep.cuh",
        "const bool takes = inside && (unsigned)(row + dy) < rows_inside;",
        "const bool takes = inside;",
        (_GPU, "-k", "plane_sweep and equals"),
    ),
    Fault(
        "the mask of a sweep on a GPU",
        "kernels/warp/native/plane_sweep.cuh",
        "mark = right ? is_counted(b) : is_counted(a);",
        "mark = is_counted(a);",
        (_GPU, "-k", "plane_sweep and equals"),
    ),
    Fault(
        "the row of neighbours at the top on a GPU",
        "kernels/warp/native/nlm.cuh",
        "above = y >= dy, inner",
        "above = y > dy, inner",
        (_GPU, "-k", "nlm_laplacian and equals"),
    ),
    Fault(
        "the right border of the ratio on a GPU",
        "kernels/warp/native/nlm.cuh",
        "if (y >= dy && (unsigned)(x - dx) < (unsigned)width) add(w[-step], p - step, -dx, -dy);",
        "if (y >= dy) add(w[-step], p - step, -dx, -dy);",
        (_GPU, "-k", "nlm_ratio and equals"),
    ),
    Fault(
        "the weight of the second pixel of a pair in averages on a GPU",
        "kernels/warp/native/cost_volume.cuh",
        "weights.data[k * size + p + (after ? 0 : q)]",
        "weights.data[k * size + p]",
        (_GPU, "-k", "nlm_average and equals"),
    ),
    Fault(
        "what threads of a path tell each other on a GPU",
        "kernels/warp/native/semi_global.cuh",
        "below = lane > 0 ? last_below : INFINITY;",
        "below = lane > 0 ? first_above : INFINITY;",
        (_GPU, "-k", "semi_global and equals"),
    ),
    Fault(
        "the sums of the first directions on a GPU that follows some at a time",
        "kernels/warp/semi_global.py",
        "len(some), first > 0]",
        "len(some), False]",
        (_GPU, "-k", "batches and semi_global"),
    ),
    Fault(
        "the last part of the inner products on a GPU",
        "kernels/warp/native/lbfgs.cuh",
        "part += TURNS) total",
        "part += TURNS) if (part < parts - 1) total",
        (_GPU, "-k", "lbfgs and equals"),
    ),
    Fault(
        "bounds that hold a pixel on a GPU",
        "kernels/warp/native/lbfgs.cuh",
        "direction_out.data[i] = held || stopped ? 0.f : step;",
        "direction_out.data[i] = stopped ? 0.f : step;",
        (_GPU, "-k", "lbfgs and equals"),
    ),
    Fault(
        "the order of disparities below 0 in a GPU's z-buffer",
        "kernels/warp/native/z_buffer.cuh",
        "const unsigned key = bits < 0 ? ~(unsigned)bits",
        "const unsigned key = bits < 0 ? (unsigned)bits & 0x7fffffffu",
        (_GPU, "-k", "z_buffer and equals"),
    ),
    Fault(
        "the views after the first batch of a GPU",
        "kernels/warp/z_buffer.py",
        "[keys, width], [nearest_out[first:last]]",
        "[keys, width], [nearest_out[: last - first]]",
        (_GPU, "-k", "batches"),
    ),
    Fault(
        "raw intensities in half precision on a GPU",
        "lfgpu/methods/synthesis/model.py",
        "np.float16 if on_gpu and config.detail_scale > 0 else",
        "np.float16 if on_gpu else",
        (_GPU, "-k", "printed"),
    ),
    Fault(
        "pixels that most views contradict are moved",
        "lfgpu/methods/synthesis/acceptance.py",
        "k.multiply(self._agreeing, change, change)",
        "k.multiply(self._prior.ones, change, change)",
        (_PRINTED, "-k", "no_map_worse and bars"),
    ),
    Fault(
        "tiles that begin between reduced pixels",
        "lfgpu/pipelines/tiles.py",
        "    steps = (length - side) // REDUCTION\n    return [REDUCTION * round(k * steps",
        "    steps = length - side\n    return [round(k * steps",
        ("tests/test_tiles.py", "-k", "every_pixel"),
    ),
    Fault(
        "paths shorter than patches without texture",
        "lfgpu/methods/matching/method.py",
        "_PATHS = 60",
        "_PATHS = 40",
        ("tests/test_tiles.py", "-k", "patches_without"),
    ),
    Fault(
        "similarity in proportion to the noise",
        "lfgpu/methods/matching/noise.py",
        "sigma_color=math.sqrt(times) * prior",
        "sigma_color=times * prior",
        ("tests/test_matching.py", "-k", "noise"),
    ),
    Fault(
        "grain from the median window",
        "lfgpu/methods/matching/noise.py",
        "_GRAIN_SHARE = 5 ",
        "_GRAIN_SHARE = 50 ",
        ("tests/test_matching.py", "-k", "grain_is_that"),
    ),
    Fault(
        "holes filled with certainties that the noise does not scale",
        "lfgpu/methods/matching/completion.py",
        "tuning.hole_filling.stiffness * tuning.alignment.robust**2",
        "tuning.hole_filling.stiffness * 1.0",
        ("tests/test_matching.py", "-k", "filled or outlines"),
    ),
    Fault(
        "places of a cross that are meant to be empty are missing in a report",
        "lfgpu/reports/facts.py",
        '(("missing", lost),) if lost else ()',
        '(("missing", lost),) if lf.missing else ()',
        ("tests/test_report.py", "-k", "meant_to_be_empty"),
    ),
    Fault(
        "the longest change that the noise does not scale",
        "lfgpu/methods/synthesis/plan.py",
        "longest_change=times * refinement.longest_change",
        "longest_change=refinement.longest_change",
        (_FORMULAS, "-k", "twice_the_noise"),
    ),
    Fault(
        "acceptance with what hid something in another map",
        "lfgpu/methods/synthesis/acceptance.py",
        "self._hiding(start, self._nearest)",
        "if self._hiding is None: self._hiding(start, self._nearest)",
        (_FORMULAS, "-k", "acceptance"),
    ),
    Fault(
        "confidence with what hid something in another map",
        "lfgpu/methods/synthesis/acceptance.py",
        "self._hiding(disparity, self._nearest)",
        "if self._hiding is None: self._hiding(disparity, self._nearest)",
        (_FORMULAS, "-k", "acceptance"),
    ),
    Fault(
        "masks sheared the other way",
        "lfgpu/methods/structure_tensor.py",
        "np.round(columns - shear * offset)",
        "np.round(columns + shear * offset)",
        (_FORMULAS, "-k", "shear_brings"),
    ),
    Fault(
        "likeness of frames without the noise",
        "lfgpu/methods/matching/temporal.py",
        "self._temporal.tolerance * self.noise",
        "self._temporal.tolerance * 0.01",
        (_FORMULAS, "-k", "two_frames"),
    ),
    Fault(
        "tiles that have converged if one has",
        "lfgpu/pipelines/tiles.py",
        "converged=all(result",
        "converged=any(result",
        (_FORMULAS, "-k", "tiles_have"),
    ),
    Fault(
        "the mask of the first views in the place of the used ones'",
        "lfgpu/pipelines/stream.py",
        "engine.solve(level, result.valid[self._used])",
        "engine.solve(level, result.valid[: len(self._used)])",
        (_FORMULAS, "-k", "told_by_their_place"),
    ),
    Fault(
        "frames numbered without the lock",
        "lfgpu/pipelines/stream.py",
        "        with self._numbering:\n            self._inbox",
        "        if True:\n            self._inbox",
        (_FORMULAS, "-k", "numbered"),
    ),
    Fault(
        "the nearest pixel truncated",
        "lfgpu/pipelines/all_views.py",
        "(self._y + 0.5).astype(np.intp), (self._x + 0.5).astype",
        "self._y.astype(np.intp), self._x.astype",
        (_FORMULAS, "-k", "nearest_pixel"),
    ),
    Fault(
        "vignetting not against the reference",
        "lfgpu/cameras/tones.py",
        "(falloff - gain * v / g) / g",
        "falloff / g",
        (_FORMULAS, "-k", "tones_are"),
    ),
    Fault(
        "the middle of a view with width and height exchanged",
        "lfgpu/cameras/tones.py",
        "at[..., 0] - (width - 1) / 2, at[..., 1] - (height - 1) / 2",
        "at[..., 0] - (height - 1) / 2, at[..., 1] - (width - 1) / 2",
        (_FORMULAS, "-k", "from_the_middle"),
    ),
    Fault(
        "samples that are half masked are valid",
        "lfgpu/calibration/resample.py",
        "share[..., 0] > 0.99",
        "share[..., 0] > 0.4",
        (_FORMULAS, "-k", "between_a_valid"),
    ),
    Fault(
        "half a pixel dropped where pictures are scaled",
        "lfgpu/calibration/rig.py",
        "((cx + 0.5) * across - 0.5, (cy + 0.5) * down - 0.5)",
        "(cx * across, cy * down)",
        (_FORMULAS, "-k", "half_the_size"),
    ),
    Fault(
        "the diagonal in the place of half of it",
        "lfgpu/cameras/screening.py",
        "float(np.hypot(*lf.size)) / 2",
        "float(np.hypot(*lf.size)) / 1",
        (_FORMULAS, "-k", "half_diagonal"),
    ),
    Fault(
        "a lattice turned the other way",
        "lfgpu/io/lenslet/decode.py",
        "[[c, s], [-s, c]]",
        "[[c, -s], [s, c]]",
        (_FORMULAS, "-k", "turned_as_it_states"),
    ),
    Fault(
        "nearer surfaces preferred where no map agrees",
        "lfgpu/viz/rendering.py",
        "np.maximum(seen[0] - disparity, 0)",
        "np.maximum(disparity - seen[0], 0)",
        (_FORMULAS, "-k", "farther_surface"),
    ),
    Fault(
        "half-masked pixels in refocusing",
        "lfgpu/viz/refocusing.py",
        "> 1 - 1e-3",
        "> 0.4",
        (_FORMULAS, "-k", "half_masked"),
    ),
    Fault(
        "error maps of the opposite sign",
        "lfgpu/comparison.py",
        "np.asarray(values, np.float32) - np.asarray(truth, np.float32)",
        "np.asarray(truth, np.float32) - np.asarray(values, np.float32)",
        (_FORMULAS, "-k", "too_near"),
    ),
    Fault(
        "below and above exchanged in what is said of a camera",
        "lfgpu/cameras/findings.py",
        "'below' if y > 0 else 'above'",
        "'above' if y > 0 else 'below'",
        ("tests/calibration/test_judge.py", "-k", "moved"),
    ),
    Fault(
        "a range that an interrupted estimate leaves behind",
        "lfgpu/pipelines/pipeline.py",
        "            if self.measured is not measured:",
        "            if False:",
        ("tests/test_range_confirmation.py", "-k", "interrupted"),
    ),
    Fault(
        "a damaged ring that is read again and again",
        "lfgpu/io/ring.py",
        "            if newest == before:",
        "            if False:",
        ("tests/io/test_ring.py", "-k", "no_slot_holds and 7"),
    ),
    Fault(
        "connections with the token that make room",
        "lfgpu/viewer/guard.py",
        "        self.site.door.know(connection.stream)",
        "        self.site.door is not None",
        ("tests/viewer/test_guard.py", "-k", "make_room"),
    ),
    Fault(
        "numbers for bright views with dim ones",
        "lfgpu/methods/matching/noise.py",
        "    if exposure == 1.0:",
        "    if exposure:",
        ("tests/test_matching.py", "-k", "few_steps and fast"),
    ),
    Fault(
        "the middle of a view half a pixel off",
        "lfgpu/data/geometry.py",
        "((width - 1) / 2, (height - 1) / 2)",
        "(width / 2, height / 2)",
        (_FORMULAS, "-k", "straight_ahead"),
    ),
    Fault(
        "colours of 16 bits beyond 255",
        "lfgpu/data/points.py",
        "image / 257",
        "image / 255",
        (_FORMULAS, "-k", "in_bytes"),
    ),
    Fault(
        "tangential coefficients exchanged",
        "lfgpu/calibration/cameras.py",
        "k1, k2, p1, p2, k3, k4, k5, k6 = ",
        "k1, k2, p2, p1, k3, k4, k5, k6 = ",
        (_FORMULAS, "-k", "lenses"),
    ),
    Fault(
        "half of a tangential term",
        "lfgpu/calibration/cameras.py",
        "p2 * (r2 + 2 * x * x)",
        "p2 * (r2 + x * x)",
        (_FORMULAS, "-k", "lenses"),
    ),
    Fault(
        "the third radial coefficient with the second",
        "lfgpu/calibration/cameras.py",
        "r2 * (k2 + r2 * k3)",
        "r2 * (k2 + k3)",
        (_FORMULAS, "-k", "lenses"),
    ),
    Fault(
        "a coefficient of a fisheye lens subtracted",
        "lfgpu/calibration/cameras.py",
        "k[2] + square * k[3]",
        "k[2] - square * k[3]",
        (_FORMULAS, "-k", "lenses"),
    ),
    Fault(
        "holes turned back the wrong way",
        "lfgpu/data/filling.py",
        "np.rot90(side, -turns)",
        "np.rot90(side, turns)",
        (_FORMULAS, "-k", "farther_of_its_sides"),
    ),
    Fault(
        "what is behind a camera projected",
        "lfgpu/calibration/cameras.py",
        "np.where(directions[..., 2:] > 0, directions[..., 2:], np.nan)",
        "np.where(directions[..., 2:] != 0, directions[..., 2:], np.nan)",
        (_FORMULAS, "-k", "lenses"),
    ),
    Fault(
        "rows' focal length for columns' in what reprojects a disparity",
        "lfgpu/calibration/parallel.py",
        "[0, 1 / fy, 0, -cy / fy]",
        "[0, 1 / fx, 0, -cy / fx]",
        ("tests/calibration/test_scene_export.py", "-k", "ros"),
    ),
    Fault(
        "the place of a rig that is not turned into its camera",
        "lfgpu/calibration/formats/colmap.py",
        "turn @ outer, turn @ away + shift",
        "turn @ outer, away + shift",
        ("tests/calibration/test_calibration_formats.py", "-k", "older_than"),
    ),
    Fault(
        "the depth forgotten at which cameras off their plane are corrected",
        "lfgpu/calibration/rectifiers.py",
        'float(values["corrected_at"])',
        'float("inf")',
        ("tests/calibration/test_rectifier.py", "-k", "wrote"),
    ),
    Fault(
        "vignetting by the place in the rectified picture",
        "lfgpu/calibration/rectifiers.py",
        "squared_radius_at(at, lf.size)",
        "squared_radius_at(grid, lf.size)",
        ("tests/calibration/test_rectifier.py", "-k", "wrote"),
    ),
    Fault(
        "turned views that spread disparities the other way",
        "lfgpu/cameras/trust.py",
        "(turn * shift[:, 1]).mean() - y *",
        "(turn * shift[:, 1]).mean() + y *",
        ("tests/calibration/test_trust.py", "-k", "spread"),
    ),
    Fault(
        "dim views made dimmer before it is asked what hides what",
        "lfgpu/cameras/signs.py",
        "brighter * shown",
        "shown / brighter",
        ("tests/calibration/test_judge.py", "-k", "order_of_depth"),
    ),
    Fault(
        "views that stand out by less than their errors",
        "lfgpu/cameras/consensus.py",
        "_FACTOR * np.maximum(usual, np.linalg.norm(errors, axis=1))",
        "_FACTOR * usual",
        ("tests/calibration/test_judge.py", "-k", "rim"),
    ),
    Fault(
        "the gain of a view on its offset, too",
        "lfgpu/calibration/misalign.py",
        "* view + offset[n]",
        "* (view + offset[n])",
        ("tests/calibration/test_misalign.py", "-k", "told"),
    ),
    Fault(
        "the depth of a camera behind its plane in the place of one before it",
        "lfgpu/calibration/rectify.py",
        "- rig.ahead[index]) / along",
        "+ rig.ahead[index]) / along",
        ("tests/calibration/test_original_depth.py", "-k", "as_it_was"),
    ),
    Fault(
        "depths of the scene in metres beside a calibration in millimetres",
        "lfgpu/calibration/rectify.py",
        "depths = (UNITS[unit] * depths[0], UNITS[unit] * depths[1])",
        "depths = (depths[0], depths[1])",
        ("tests/calibration/test_original_depth.py", "-k", "unit"),
    ),
    Fault(
        "what hides a point looked for on its other side",
        "lfgpu/cameras/points.py",
        "columns = np.rint(x + steps * du)",
        "columns = np.rint(x - steps * du)",
        ("tests/calibration/test_screening.py", "-k", "hidden"),
    ),
)


def noticed(fault: Fault) -> bool:
    """Inject a fault into a copy of the project and return True if its tests fail there."""
    with tempfile.TemporaryDirectory() as folder:
        for name in _COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, Path(folder) / name, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, folder)
        broken = Path(folder) / fault.file
        text = broken.read_text(encoding="utf-8")
        if fault.old not in text:
            raise SystemExit(f"{fault.name}: {fault.file} holds no {fault.old!r} any more.")
        broken.write_text(text.replace(fault.old, fault.new), encoding="utf-8")
        command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *fault.tests]
        environment = {**os.environ, "PYTHONPATH": folder, "LFGPU_THREADS": "1"}
        done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        if done.returncode not in (0, 1):
            raise SystemExit(f"{fault.name}: pytest could not run.\n{done.stdout}{done.stderr}")
        return done.returncode == 1


def main() -> int:
    """Inject every fault whose name holds the first argument, or all; 1 if one is not noticed."""
    wanted = [fault for fault in FAULTS if not sys.argv[1:] or sys.argv[1] in fault.name]
    with ThreadPoolExecutor(get_threads()) as pool:
        found = []
        for fault, one in zip(wanted, pool.map(noticed, wanted), strict=True):
            found.append(one)
            print(f"{'noticed' if one else 'NOT NOTICED'}: {fault.name} ({fault.file})", flush=True)
    return int(not all(found))


if __name__ == "__main__":
    sys.exit(main())
