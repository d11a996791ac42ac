"""Formulas of the host against numbers that were worked out by hand, or simulated forwards by other code."""

import math
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import lfgpu
from lfgpu import scenes
from lfgpu._backends import load
from lfgpu.calibration.cameras import Camera as Calibrated
from lfgpu.calibration.resample import resampled
from lfgpu.calibration.rig import matched
from lfgpu.cameras.screening import worth_a_look
from lfgpu.cameras.tones import match_tones, squared_radius_at
from lfgpu.contract import Device
from lfgpu.data import DisparityMap, Geometry, LightField, ViewsResult
from lfgpu.data.filling import fill_unknown
from lfgpu.io.lenslet.decode import _expected
from lfgpu.io.lytro.contents import MicrolensArray
from lfgpu.methods import preset
from lfgpu.methods.matching.method import Matching
from lfgpu.methods.matching.temporal import TemporalMatching
from lfgpu.methods.measured import Measured
from lfgpu.methods.prior import NonLocalMeans
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import _rests_on_valid
from lfgpu.methods.synthesis.acceptance import Acceptance
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.plan import in_units_of
from lfgpu.methods.temporal_prior import TemporalPrior
from lfgpu.pipelines.all_views import _Place
from lfgpu.pipelines.tiles import Plan, _joined
from lfgpu.viz.rendering import Renderer
from lfgpu.viz.sheets import overview

RANGE = (-1.6, 1.7)
REFERENCE = Device(load("reference"), "cpu")


# --- synthesis ---


def test_twice_the_noise_is_twice_of_what_is_in_units_of_it() -> None:
    config = in_units_of(Measured(RANGE, noise=0.008), SynthesisConfig())
    prior, refinement = config.prior, config.refinement
    found = (prior.sigma_color, prior.sigma_gradient, refinement.contrast_floor, refinement.longest_change)
    assert found == pytest.approx((0.03, 0.03, 0.02, 0.4))


def test_acceptance_looks_at_what_hides_in_the_maps_that_it_is_given() -> None:
    lf = scenes.make("boxes", grid=(3, 3), size=(32, 36))
    kernels, truth = REFERENCE.kernels, lf.truth.disparity  # type: ignore[union-attr]
    prior = NonLocalMeans((*lf.size, lf.channels), SynthesisConfig().prior, REFERENCE)
    image, views = kernels.image(lf.image(lf.reference_index), "cpu"), kernels.image(lf.views, "cpu")
    prior.load(image)

    def accepted(acceptance: Acceptance, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        moved, confidence = kernels.field(start + 0.04, "cpu"), kernels.zeros(lf.size, "cpu")
        acceptance.run(image, views, None, kernels.field(start, "cpu"), moved)
        acceptance.judge(kernels.field(start, "cpu"), confidence)
        return kernels.numpy(moved).copy(), kernels.numpy(confidence).copy()

    def fresh() -> Acceptance:
        return Acceptance(lf.layout, prior, 0.2, 1.0, REFERENCE)

    used, other = fresh(), np.where(np.arange(36) < 18, 1.5, -1.5) * np.ones(lf.size)
    accepted(used, other)
    for found, want in zip(accepted(used, truth), accepted(fresh(), truth), strict=True):
        np.testing.assert_array_equal(found, want)
    judged = [kernels.zeros(lf.size, "cpu") for _ in range(2)]
    alone = fresh()
    alone.run(image, views, None, kernels.field(other, "cpu"), kernels.field(other, "cpu"))
    alone.judge(kernels.field(truth, "cpu"), judged[0])
    used.judge(kernels.field(truth, "cpu"), judged[1])
    np.testing.assert_array_equal(*judged)


def test_a_masked_pixel_is_where_the_shear_brings_it() -> None:
    """The point at x = 22 is at 22 - 2 u in the view at u."""
    valid = np.ones((3, 1, 40), bool)
    valid[2, 0, 20] = False
    trusted = _rests_on_valid(valid, np.array([-1.0, 0.0, 1.0]), 2.0, LocalConfig(inner_scale=0.5, outer_scale=0.4))
    assert np.flatnonzero(~trusted[0]).tolist() == [19, 20, 21, 22, 23, 24, 25]


# --- streams and tiles ---


def test_what_looks_alike_in_two_frames_is_a_matter_of_the_noise() -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(32, 36))
    asked = []
    for noise in (0.005, 0.02):
        method, device = Matching(preset("fast")), Device(load("warp"), "cpu")  # type: ignore[arg-type]
        streaming = device.kernels.streaming
        plan = method.live_plan(
            lf.layout, Measured(RANGE, noise), device, streaming=streaming, prior=TemporalPrior(tolerance=3.0)
        )
        assert isinstance(plan, TemporalMatching)
        plan._motion.find = lambda *_, tolerance, same_out: asked.append(tolerance)  # type: ignore[method-assign]
        views = device.kernels.image(lf.views, "cpu")
        plan.cold(views, 1, again=False)
        plan.warm(views, 1)
    assert asked == pytest.approx([0.015, 0.06])


def test_tiles_have_converged_if_all_have() -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(32, 36))
    result = lfgpu.estimate_depth(lf, config="fast", disparity_range=RANGE, device="cpu")
    plan = Plan((32, 36), ((0, 0), (0, 0)), (0, 0))
    for states in ((True, False), (False, True)):
        results = [replace(result, converged=state) for state in states]
        assert not _joined(lf, plan, results, 0.1).converged


def test_cameras_without_a_picture_are_told_by_their_place_among_the_used_ones() -> None:
    lf = scenes.make("planes", grid=(5, 5), size=(40, 44))
    present, told = np.ones(25, bool), []
    present[[0, 22]] = False  # a corner, which is not used, and the last view of the reference's column, which is
    with lfgpu.DepthStream(lf, config="fast", disparity_range=RANGE, device="cpu", policy="block") as stream:
        solve = stream._engine.solve
        stream._engine.solve = lambda level, there: (told.append(there.tolist()), solve(level, there))[1]  # type: ignore[method-assign]
        stream.push(lf.views, valid=present).numpy()
        used = stream.used_views
    assert sorted(used) == [2, 7, 10, 11, 12, 13, 14, 17, 22]
    assert told == [[n != 22 for n in used]]


def test_frames_of_several_threads_are_numbered_one_by_one() -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(32, 36))
    with lfgpu.DepthStream(lf, config="fast", disparity_range=RANGE, device="cpu", policy="block") as stream:
        both, met, seen = threading.Barrier(2), [], set[int]()

        def meet() -> None:
            if threading.get_ident() in seen:  # later ones of a frame are not of its number
                return
            seen.add(threading.get_ident())
            try:
                both.wait(0.5)
                met.append(True)
            except threading.BrokenBarrierError:
                both.reset()

        stream._inbox.refuse_if_closed = meet  # type: ignore[method-assign]
        results: list[Any] = []
        threads = [threading.Thread(target=lambda: results.append(stream.push(lf.views))) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert not met
    assert sorted(result.index for result in results) == [0, 1]


# --- geometry ---


def test_the_middle_of_a_view_is_straight_ahead() -> None:
    points = Geometry(focal_length_px=100, baseline_m=0.1).points(np.full((5, 7), 2.0))
    assert points[2, 3] == pytest.approx([0, 0, 5])
    assert points[0, 0] == pytest.approx([-0.15, -0.1, 5])


@pytest.mark.parametrize(("kind", "times"), [("uint8", 1), ("uint16", 257), ("float32", 1 / 255)])
def test_points_have_the_colours_of_the_picture_in_bytes(kind: str, times: float) -> None:
    image = (np.full((2, 3, 1), 200) * times).astype(kind)
    cloud = lfgpu.point_cloud(DisparityMap(np.ones((2, 3), np.float32)), image=image)
    assert cloud.colors is not None
    assert (cloud.colors == 200).all()


def test_the_least_confidence_of_points_is_a_number() -> None:
    map_ = DisparityMap(np.ones((2, 3), np.float32), np.zeros((2, 3), np.float32))
    for wrong in (float("nan"), "0.5", -1, 50):
        with pytest.raises(lfgpu.LightFieldError, match="least_confidence must be a number from 0 to 1"):
            lfgpu.point_cloud(map_, least_confidence=wrong)  # type: ignore[arg-type]


def test_a_hole_takes_the_farther_of_its_sides() -> None:
    hole = np.array([[3, 3, 3, 3], [3, np.nan, 1, 3]])
    assert fill_unknown(hole).tolist() == [[3, 3, 3, 3], [3, 1, 1, 3]]
    assert fill_unknown(hole.T).tolist() == [[3, 3], [3, 1], [3, 1], [3, 3]]


# --- all views, new views, pictures ---


def test_the_nearest_pixel_is_the_nearest() -> None:
    place = _Place(np.float32([0.4, 0.6, 1.7]), np.float32([0.0, 0.6, 0.2]), (2, 3))
    assert place.nearest(np.arange(6.0).reshape(2, 3)).tolist() == [0, 4, 2]


def test_where_no_map_agrees_the_farther_surface_shows() -> None:
    lf = LightField(np.full((2, 8, 8, 3), 100, np.uint8), np.array([(0.0, 0.0), (1.0, 0.0)]))
    maps = np.stack([np.full((8, 8), d, np.float32) for d in (0.5, -0.5)])
    renderer = Renderer(lf, ViewsResult(maps, np.ones_like(maps), lf.positions, (0, 1), None, {}), device="cpu")  # type: ignore[arg-type]
    place, assumed = np.array([0.5, 0.0]), np.zeros((8, 8), np.float32)
    nearer, farther = (renderer._look(n, place, assumed, 0.1)[2][4, 4] for n in (0, 1))
    assert farther > 100 * nearer


def test_pixels_that_are_half_masked_do_not_count_in_refocusing() -> None:
    views = np.stack([np.full((8, 8, 1), value, np.float32) for value in (0.2, 0.8)])
    valid = np.ones((2, 8, 8), bool)
    valid[1, :, 4] = False
    lf = LightField(views, np.array([(0.0, 0.0), (1.0, 0.0)]), reference=0, valid=valid)
    found = lfgpu.refocus(lf, 0.5)[3, :, 0]  # the point at x is at x - 0.5 in the other view: 4 and 5 are half masked
    assert found[2:7] == pytest.approx([0.5, 0.5, 0.2, 0.2, 0.5], abs=0.01)


def test_what_is_too_near_is_red_and_what_is_too_far_blue() -> None:
    lf = scenes.make("planes", grid=(3, 3), size=(40, 48))
    truth = lf.truth.disparity  # type: ignore[union-attr]
    shares = []
    for error in (0.1, -0.1):
        picture = overview(lf.image(lf.reference_index), truth + np.float32(error), truth, title="")
        red, blue = (np.asarray(picture)[..., c].astype(int) for c in (0, 2))
        shares.append(((red - blue > 60).mean(), (blue - red > 60).mean()))
    assert shares[0][0] > shares[1][0] + 0.1
    assert shares[1][1] > shares[0][1] + 0.1


# --- cameras ---


def test_lenses_distort_as_opencv_defines_them() -> None:
    k1, k2, p1, p2, k3, x, y = 0.1, -0.02, 0.03, -0.05, 0.04, 0.5, 0.25
    r = math.hypot(x, y)
    radial = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6
    across = x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
    down = y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    camera = Calibrated((100, 200), (300.0, 310.0), (99.5, 20.5), distortion=(k1, k2, p1, p2, k3))
    assert camera.project([x, y, 1]) == pytest.approx([300 * across + 99.5, 310 * down + 20.5])
    angle, k = math.atan(r), (0.1, -0.02, 0.03, 0.04)
    bent = angle * (1 + k[0] * angle**2 + k[1] * angle**4 + k[2] * angle**6 + k[3] * angle**8) / r
    fisheye = Calibrated((100, 200), (300.0, 310.0), (99.5, 20.5), distortion=k, model="fisheye")
    assert np.isnan(camera.project([x, y, -1])).all()
    assert fisheye.project([x, y, 1]) == pytest.approx([300 * x * bent + 99.5, 310 * y * bent + 20.5])


def test_a_place_in_a_view_has_its_distance_from_the_middle() -> None:
    places = np.array([(2.0, 1.0), (0.0, 0.0), (4.0, 1.0), (2.0, 2.0)])
    assert squared_radius_at(places, (3, 5)) == pytest.approx(np.array([0, 5, 4, 1]) * 4 / 34)


def test_tones_are_those_with_which_the_views_were_made() -> None:
    rng, count, points = np.random.default_rng(3), 5, 4000
    gain, offset, falloff = np.array([[1, 1.1, 0.9, 1.2, 1], [0, 0.02, -0.01, 0, 0.01], [0, -0.1, 0.05, -0.2, 0.1]])
    radius2, shown = np.tile(rng.uniform(0, 1, points), (count, 1)), rng.uniform(0.2, 0.7, points)
    views = (gain[:, None] + falloff[:, None] * radius2) * shown + offset[:, None]
    found = match_tones(views, np.ones_like(views), radius2, 0, vignetting=True)
    for values, want in zip(found, (gain, offset, falloff), strict=True):
        assert values == pytest.approx(want, abs=0.01)


def test_a_place_between_a_valid_and_a_masked_pixel_is_masked() -> None:
    views = np.random.default_rng(1).random((2, 12, 20, 1), np.float32)
    valid = np.ones((2, 12, 20), bool)
    valid[:, :, 10:] = False
    lf = LightField(views, np.array([(0.0, 0.0), (1.0, 0.0)]), valid=valid)
    y, x = np.mgrid[:12, :20].astype(float)
    _, found = resampled(lf, lambda n: np.stack([x + 0.5 * n, y], axis=-1))
    assert found[0, 6, 8:12].tolist() == [True, True, False, False]
    assert found[1, 6, 9:12].tolist() == [False, False, False]


def test_pictures_of_half_the_size_have_their_middle_in_the_middle() -> None:
    """The centre of the first pixel is half a pixel from the edge, whatever the size of pixels."""
    camera = Calibrated((100, 200), (300.0, 310.0), (99.5, 20.5))
    (found,) = matched([camera], ["a.png"], (50, 100), "rig")
    assert found.focal_length == (150.0, 155.0)
    assert found.principal_point == (49.5, 10.0)


@pytest.mark.parametrize(("pixels", "worth"), [(0.05, False), (0.15, True)])
def test_a_turn_counts_by_what_it_moves_at_the_half_diagonal(pixels: float, worth: bool) -> None:
    from scipy import ndimage

    lf = scenes.make("boxes", grid=(5, 5), size=(160, 176), seed=3, noise=0.002)
    views = lf.views.copy()
    degrees = math.degrees(pixels / (math.hypot(160, 176) / 2))
    views[7] = ndimage.rotate(views[7], degrees, axes=(1, 0), reshape=False, order=3, mode="nearest")
    assert worth_a_look(replace(lf, views=views), lf.truth.disparity) == worth  # type: ignore[union-attr]


def test_the_lattice_that_a_camera_states_is_turned_as_it_states() -> None:
    array = MicrolensArray(pitch=10.0, rotation=0.1, stretch=1.0)
    capture = type("Capture", (), {"camera": type("Camera", (), {"microlenses": array})})
    found = _expected(capture)  # type: ignore[arg-type]
    assert found.along == pytest.approx([10 * math.cos(0.1), 10 * math.sin(0.1)])
    assert found.down == pytest.approx([10 * math.cos(0.1 + math.pi / 3), 10 * math.sin(0.1 + math.pi / 3)])
