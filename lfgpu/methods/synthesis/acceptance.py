"""Acceptance: the share of the refinement that each pixel takes, by the views that see the pixel; and the confidence.

The additive model of the refinement knows no occlusions, and moves pixels beside outlines away from the truth. The
acceptance compares only the views in which nothing nearer hides a pixel, each with the robust mean of these views
(`lfgpu.contract.Alignment`). The derivative of their agreement along the change of a pixel is known at both ends of the
change, so the change is cut where the views agree best between the ends. The derivative means something near the truth
only: a pixel on the wrong surface could go anywhere. So pixels stay where most views disagree with the mean at the
start.
"""

from lfgpu.contract import Array, Device
from lfgpu.data.layout import ViewLayout
from lfgpu.methods.prior import NonLocalMeans

_GRADIENT_WEIGHT = 2.0  # weight of image gradients against intensities
_CONTRAST = 0.07  # intensity at the usual noise: steps between pixels that halve the weight of gradients around them
_ROBUST = 0.005  # intensity at the usual noise: larger differences from the mean of the views count less
_UNLIMITED = 10.0  # intensity: all views count the same
_LEAST_SHARE = 0.2  # share of agreeing views in the curvature of all views at which a pixel is moved half as far
_TOLERANCE = 1.2  # pixels in the farthest view: a surface hides only what lies behind it by more
_REACH = 1  # pixels around a surface in another view that are hidden as well: there both sides mix
_STIFFNESS = 0.1  # 1 / pixel²: curvature over robust² at which the confidence is a half


class Acceptance:
    """Step of each pixel from one map towards another, as far as the views agree better.

    A pixel is moved by at most `longest` pixels in the farthest view; `noise` is in units of the usual one, >= 1.
    """

    def __init__(self, layout: ViewLayout, prior: NonLocalMeans, longest: float, noise: float, device: Device) -> None:
        kernels = device.kernels
        self._kernels, self._prior = kernels, prior
        shape, offsets = layout.shape, device.field(layout.offsets)
        self._longest = longest / layout.farthest
        self._no_texture = _STIFFNESS * (_ROBUST * noise) ** 2
        self._apart = 2.0 * layout.farthest**2
        self._nearest = device.zeros(shape[:3])
        self._offsets, self._hiding = offsets, kernels.z_buffer(layout.size, device.name, reach=_REACH)
        self._align, self._align_all = (
            kernels.alignment(
                shape,
                offsets,
                scale=layout.scale,
                gradient_weight=_GRADIENT_WEIGHT,
                contrast=_CONTRAST * noise,
                robust=robust,
                tolerance=_TOLERANCE / layout.farthest,
            )
            for robust in (_ROBUST * noise, _UNLIMITED)
        )
        self._change, self._slope, self._curvature, self._gain, self._loss, self._agreeing = (
            device.zeros(layout.size) for _ in range(6)
        )

    def run(self, image: Array, views: Array, valid: Array | None, start: Array, disparity: Array) -> None:
        """Move `start` towards `disparity`, fields [y, x]; `disparity` becomes the result.

        `image` [y, x, c] is the reference image, `views` [n, y, x, c] are the views as stored, `valid` [n, y, x]
        or None is their mask.
        """
        k, change, gain, loss = self._kernels, self._change, self._gain, self._loss
        self._align.load(image, views, valid)
        self._align_all.load(image, views, valid)
        self._hiding(start, self._offsets, self._nearest, reach=_REACH)
        k.axpby(1.0, disparity, -1.0, start, change)
        k.clamp(change, -self._longest, self._longest, change)
        k.axpby(1.0, start, 1.0, change, disparity)
        self._improvement(start, gain)
        self._agreement(start)
        self._improvement(disparity, loss)
        k.axpby(-1.0, loss, 0.0, loss, loss)
        k.clamp(gain, 0.0, 1.0, gain)
        k.clamp(loss, 0.0, 1.0, loss)
        # The parabola through both derivatives has its minimum at gain / (gain + loss) of the way. Another one, as wide
        # as that of a pixel whose confidence is a half, holds the pixel where it is: no evidence moves nothing.
        k.axpby(1.0, gain, 1.0, loss, loss)
        k.multiply(change, change, self._slope)
        k.axpby(1.0, loss, self._no_texture, self._slope, loss)
        k.divide(gain, loss, gain)  # 0 where nothing would change
        k.multiply(gain, change, change)
        k.multiply(self._agreeing, change, change)
        k.axpby(1.0, start, 1.0, change, disparity)

    def judge(self, disparity: Array, confidence_out: Array) -> None:
        """Confidence [y, x], 0 to 1, in a map [y, x]: how surely the views fix it, less where the map is not smooth.

        It is c / (c + κ) / (1 + 2 s²). c is the curvature of the views' agreement, the mean over like pixels; it is
        small where there is no texture and where few views agree. s² is the variance of the map among like pixels,
        pixels² in the farthest view. The confidence tells better pixels from worse ones; it is no probability.
        """
        k, prior, mean, square = self._kernels, self._prior, self._gain, self._loss
        self._hiding(disparity, self._offsets, self._nearest, reach=_REACH)
        self._align(disparity, self._nearest, self._curvature, self._slope)
        prior.mean(disparity, mean)
        k.axpby(1.0, disparity, -1.0, mean, self._change)
        k.multiply(self._change, self._change, self._slope)
        prior.mean(self._slope, square)
        prior.mean(self._curvature, mean)
        k.axpby(self._no_texture, prior.ones, 1.0, mean, self._curvature)
        k.divide(mean, self._curvature, mean)
        k.axpby(self._apart, square, 1.0, prior.ones, square)
        k.divide(mean, square, confidence_out)

    def _improvement(self, disparity: Array, improvement_out: Array) -> None:
        """Measure how much better the views agree per share of the change, at a map; the mean over like pixels."""
        self._align(disparity, self._nearest, self._curvature, self._slope)
        self._kernels.multiply(self._slope, self._change, self._slope)
        self._prior.mean(self._slope, improvement_out)

    def _agreement(self, start: Array) -> None:
        """agreeing = f² / (f² + _LEAST_SHARE²), f the share of the curvature at the start that agreeing views have.

        `_improvement` was called for the start. Where there is no texture it is 0.
        """
        k, prior, some, all_ = self._kernels, self._prior, self._agreeing, self._loss
        prior.mean(self._curvature, some)
        self._align_all(start, self._nearest, self._curvature, self._slope)
        prior.mean(self._curvature, all_)
        k.multiply(some, some, some)
        k.multiply(all_, all_, all_)
        k.axpby(1.0, some, _LEAST_SHARE**2, all_, all_)
        k.divide(some, all_, some)
