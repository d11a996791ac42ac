"""The printed equations of Sajjadi et al. 2016 as plain loops in float64, and the errors of kernels against them.

Nothing of the equations comes from the package's own code, which is compared with them. The paper's slope is m = -d.
"""

import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfgpu import LightField
from lfgpu.contract import Device, KernelSet
from lfgpu.methods import preset
from lfgpu.methods.measured import Measured
from lfgpu.methods.sections import LocalConfig
from lfgpu.methods.structure_tensor import LocalEstimator
from lfgpu.methods.synthesis.config import SynthesisConfig
from lfgpu.methods.synthesis.energy import Energy
from lfgpu.methods.synthesis.model import ForwardModel
from lfgpu.methods.synthesis.plan import in_units_of, planned_prior, spread
from lfgpu.methods.synthesis.propagation import Propagation

Array = NDArray[np.float64]

SIGMA, TAU = 1.0, 0.5
"""Scales of the structure tensor (§5), as Wanner and Goldluecke use these letters: tensors are averaged with the outer
scale σ, and gradients are taken at the inner scale τ. Pixels, and steps between the cameras of a line."""

_CUT = 1e-3  # Gaussians end where they are below this


# --- the prior: equations 1 and 2 ---


def variances(image: Array, patch: int) -> tuple[float, float]:
    """σ² of the colours and of the gradients I(p) - I(p'), p' in the patch around p; means over the channels."""
    height, width, channels = image.shape
    reach = range(-(patch // 2), patch // 2 + 1)
    gradients: list[Array] = []
    for y, x, dy, dx in itertools.product(range(height), range(width), reach, reach):
        if (dy, dx) != (0, 0) and 0 <= y + dy < height and 0 <= x + dx < width:
            gradients.append(image[y, x] - image[y + dy, x + dx])
    colours = image.reshape(-1, channels)
    return float(np.mean(colours.var(0))), float(np.mean(np.array(gradients).var(0)))


def weights(image: Array, window: int, patch: int, colour: float, gradient: float) -> Array:
    """w_pq of every two pixels, [p, q]: 0 beyond the window, 1 for q = p. `colour` and `gradient` are the σ²."""
    height, width, channels = image.shape
    pixels = list(np.ndindex(height, width))
    reach = list(itertools.product(range(-(patch // 2), patch // 2 + 1), repeat=2))

    def inside(y: int, x: int) -> bool:
        return 0 <= y < height and 0 <= x < width

    def weight(p: tuple[int, ...], q: tuple[int, ...]) -> float:
        exponent = 0.0
        for dy, dx in reach:
            p_, q_ = (p[0] + dy, p[1] + dx), (q[0] + dy, q[1] + dx)
            if inside(*p_) and inside(*q_):
                for c in range(channels):
                    exponent += (image[p_][c] - image[q_][c]) ** 2 / colour / channels
                    nabla_p, nabla_q = image[p][c] - image[p_][c], image[q][c] - image[q_][c]
                    exponent += (nabla_p - nabla_q) ** 2 / gradient / channels
        return float(np.exp(-exponent))

    w = np.zeros((len(pixels), len(pixels)))
    for (i, p), (j, q) in itertools.product(enumerate(pixels), repeat=2):
        if max(abs(p[0] - q[0]), abs(p[1] - q[1])) <= window // 2:
            w[i, j] = weight(p, q)
    return w


def prior(m: Array, w: Array, local: Array | None = None, coherence: Array | None = None) -> float:
    """R(m) = Σ_p Σ_{q in N(p)} w_pq [(m_p - m_q)² + C_p (m0_p - m_q)²]; C = 0 without a local estimate."""
    v = m.ravel()
    m0, c = (np.zeros_like(v) if one is None else one.ravel() for one in (local, coherence))
    pairs = itertools.product(range(len(v)), repeat=2)
    return float(sum(w[p, q] * ((v[p] - v[q]) ** 2 + c[p] * (m0[p] - v[q]) ** 2) for p, q in pairs))


def propagated(local: Array, coherence: Array, w: Array) -> Array:
    """argmin_m Σ_p Σ_{q in N(p)} w_pq [(m_p - m_q)² + C_p (m0_p - m_q)²]: where its derivative is 0."""
    m0, c = local.ravel(), coherence.ravel()
    n = len(m0)
    matrix, right = np.zeros((n, n)), np.zeros(n)
    for p, q in itertools.product(range(n), repeat=2):  # the derivative of each term by m_p and by m_q
        matrix[p, p] += w[p, q]
        matrix[p, q] -= w[p, q]
        matrix[q, q] += w[p, q] * (1 + c[p])
        matrix[q, p] -= w[p, q]
        right[q] += w[p, q] * c[p] * m0[p]
    return np.asarray(np.linalg.solve(matrix, right).reshape(local.shape))


# --- the generative model: section 6 ---


def triangle(x: float, softness: float) -> float:
    """Λ: the triangle on [-1, 1] whose slope goes to 0 linearly within `softness` of its three kinks."""
    edges, s = np.array([0.0, softness, 1.0 - softness, 1.0]), 1.0 / (1.0 - softness)
    slopes, at = np.array([0.0, s, s, 0.0]), min(abs(x), 1.0)
    places = np.concatenate([[at], edges[edges > at]])
    values = np.interp(places, edges, slopes)
    return float((np.diff(places) * (values[:-1] + values[1:]) / 2).sum())


def predicted(image: Array, m: Array, s: float, t: float, softness: float) -> Array:
    """L̃_m(s, t, x, y) = Σ I(x_c, y_c) Λ(x - x_c - m s) Λ(y - y_c - m t), for all x and y: [y, x, c]."""
    view = np.zeros_like(image)
    height, width = m.shape
    for y_c, x_c, y, x in itertools.product(range(height), range(width), range(height), range(width)):
        across, down = x - x_c - m[y_c, x_c] * s, y - y_c - m[y_c, x_c] * t
        if abs(across) < 1 and abs(down) < 1:
            view[y, x] += image[y_c, x_c] * triangle(across, softness) * triangle(down, softness)
    return view


def energy(
    views: Array,
    offsets: Array,
    image: Array,
    disparity: Array,
    w: Array,
    smoothness: float,
    local: tuple[Array, Array] | tuple[()] = (),
) -> float:
    """‖L̃_m - L‖² + λ R(m), softness 0.1; `local` holds m0 and C."""
    total = 0.0
    for view, (du, dv) in zip(views, offsets, strict=True):
        total += float(((predicted(image, -disparity, du, dv, 0.1) - view) ** 2).sum())
    return total + smoothness * prior(disparity, w, *local)


# --- the local estimate: section 5, and Wanner and Goldluecke 2012 ---


def fitted(values: Array, distances: Array, scale: float) -> tuple[Array, Array]:
    """Value and slope at distance 0 of the lines through values [k, ..], with Gaussian weights: each [..]."""
    weight = np.exp(-0.5 * (distances / scale) ** 2)
    near = weight >= _CUT * (1 - 1e-12)
    flat = values[near].reshape(int(near.sum()), -1)
    slope, value = np.polyfit(distances[near], flat, 1, w=np.sqrt(weight[near]))
    return value.reshape(values.shape[1:]), slope.reshape(values.shape[1:])


def structure(epis: Array, offsets: Array, shear: float, floor: float) -> tuple[Array, Array]:
    """Disparity and coherence [y, x] of EPIs [u, y, x, c] that are sheared first; the border is repeated."""
    width = epis.shape[2]
    sheared = np.empty_like(epis)
    for u, offset in enumerate(offsets):
        for x in range(width):
            place = min(max(x - shear * offset, 0.0), width - 1.0)
            left = min(int(place), width - 2)
            share = place - left
            sheared[u, :, x] = (1 - share) * epis[u, :, left] + share * epis[u, :, left + 1]

    def around(values: Array, scale: float, take: Callable[[Array, Array], Array]) -> Array:
        reach = int(scale * np.sqrt(-2 * np.log(_CUT)))
        distances = np.arange(-reach, reach + 1.0)
        columns = [
            take(np.stack([values[:, min(max(x + int(k), 0), width - 1)] for k in distances]), distances)
            for x in range(width)
        ]
        return np.stack(columns, axis=1)

    tensor, total = np.zeros((3, *epis.shape[1:3])), 0.0
    for place in offsets[np.exp(-0.5 * (offsets / SIGMA) ** 2) >= _CUT]:
        value, slope = fitted(sheared, offsets - place, TAU)
        e_x = around(value, TAU, lambda v, d: fitted(v, d, TAU)[1])
        e_u = around(slope, TAU, lambda v, d: fitted(v, d, TAU)[0])
        weight = float(np.exp(-0.5 * (place / SIGMA) ** 2))
        tensor += weight * np.stack([(e_x * e_x).sum(2), (e_x * e_u).sum(2), (e_u * e_u).sum(2)])
        total += weight

    def smoothed(v: Array, d: Array) -> Array:
        g = np.exp(-0.5 * (d / SIGMA) ** 2)
        return np.asarray(np.tensordot(g / g.sum(), v, axes=1))

    xx, xu, uu = (around(part / total, SIGMA, smoothed) for part in tensor)
    disparity = shear + np.tan(0.5 * np.arctan2(2 * xu, xx - uu))
    return disparity, ((xx - uu) ** 2 + 4 * xu**2) / (xx + uu + floor**2) ** 2


def local_estimate(
    views: Array, offsets: Array, spacing: float, bounds: tuple[float, float], config: LocalConfig
) -> tuple[Array, Array]:
    """The most coherent estimate of a line of views [u, y, x, c] along x, one camera each `spacing` view steps."""
    low, high = bounds
    best = np.zeros((2, *views.shape[1:3]))
    first, last = (round(bound * spacing / config.shear_step) for bound in bounds)
    for shear in (config.shear_step * k for k in range(first, last + 1)):
        steps = offsets / spacing
        found, coherence = structure(views, steps, shear, config.gradient_floor)
        disparity = found / spacing
        better = (abs(found - shear) <= config.shear_step) & (disparity >= low) & (disparity <= high)
        better &= coherence > best[1]
        best[:, better] = np.stack([disparity, coherence])[:, better]
    return best[0], best[1]


# --- the kernels against them ---

WINDOW = 5  # smaller than the paper's 11: the loops above are slow


def exact_config() -> SynthesisConfig:
    """The preset `paper-exact` with a smaller window."""
    config = preset("paper-exact")
    assert isinstance(config, SynthesisConfig)
    return replace(config, prior=replace(config.prior, window=WINDOW))


def small_light_field(seed: int = 0, size: tuple[int, int] = (7, 8)) -> LightField:
    """Smooth random views of 3 x 3 cameras."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: size[0], : size[1]]
    phases = rng.uniform(0, 6, (3, 3))
    views = np.empty((3, 3, *size, 3), np.float32)
    for v, u, c in np.ndindex(3, 3, 3):
        views[v, u, ..., c] = 0.5 + 0.4 * np.sin(0.9 * (x + 0.6 * (u - 1)) + 0.7 * (y + 0.6 * (v - 1)) + phases[0, c])
    return LightField.from_grid((views + rng.uniform(-0.05, 0.05, views.shape)).clip(0, 1).astype(np.float32))


def wide_columns(size: tuple[int, int] = (20, 22)) -> LightField:
    """Smooth views of 5 columns, 1 view step apart, and 3 rows, 2 view steps apart."""
    rng = np.random.default_rng(3)
    y, x = np.mgrid[: size[0], : size[1]]
    views = np.empty((3, 5, *size, 3), np.float32)
    waves = rng.uniform(0.3, 0.9, (4, 2)) * rng.choice([-1, 1], (4, 2))
    phases = rng.uniform(0, 6, (4, 3))
    disparity = 0.35 + 0.01 * x
    for v, u, c in np.ndindex(3, 5, 3):
        at_x, at_y = x + disparity * (u - 2), y + disparity * 2 * (v - 1)
        views[v, u, ..., c] = (
            0.5 + sum(np.sin(a * at_x + b * at_y + p[c]) for (a, b), p in zip(waves, phases, strict=True)) / 9
        )
    positions = [(float(u), 2.0 * v) for v in range(3) for u in range(5)]
    return LightField(views.reshape(15, *size, 3), np.array(positions), reference=7)


def errors(kernels: KernelSet, device: str) -> dict[str, float]:
    """Largest relative differences of a backend from the printed equations, by what is printed.

    They are relative to the largest value; of the local estimates, to a disparity of 1 pixel and a coherence of 1.
    """
    lf, config = small_light_field(), exact_config()
    image = lf.image(lf.reference_index).astype(np.float64)
    rng = np.random.default_rng(1)
    disparity, estimate = (rng.uniform(-0.9, 0.9, lf.size) for _ in range(2))
    colour, gradient = variances(image, config.prior.patch)
    w = weights(image, config.prior.window, config.prior.patch, colour, gradient)

    sigma_colour, sigma_gradient = measured = spread(lf, config.prior.patch)
    ours = in_units_of(Measured((-1.0, 1.0), spread=measured), config)
    plan = planned_prior((*lf.size, lf.channels), ours.prior, Device(kernels, device))
    plan.load(kernels.image(lf.image(lf.reference_index), device))
    columns = []
    for unit in np.eye(image[..., 0].size):
        sums = kernels.zeros(lf.size, device)
        plan.neighbors(kernels.field(unit.reshape(lf.size), device), sums)
        columns.append(kernels.numpy(sums).astype(np.float64).ravel())
    found_w = np.stack(columns, axis=1)

    coherence = np.where(rng.random(lf.size) < 0.6, rng.uniform(0.8, 1, lf.size), 0)
    fill = Propagation(lf.size, (-1.0, 1.0), plan, replace(ours.propagation, solver="cg", tolerance=1e-7))
    fill.run(kernels.field(estimate, device), kernels.field(coherence, device))
    local = estimate, coherence

    model = ForwardModel(lf.layout, ours.refinement, Device(kernels, device))
    model.load(kernels.image(lf.views, device), kernels.field(disparity, device))
    objective = Energy(model, plan, ours.refinement.smoothness, local=fill)
    slope, value = kernels.zeros(lf.size, device), kernels.scalar(0.0, device)
    objective(kernels.field(disparity, device), slope, value)
    views = np.stack([lf.image(n) for n in range(len(lf.views))]).astype(np.float64)

    def energy_at(moved: Array) -> float:
        return energy(views, lf.offsets, image, moved, w, ours.refinement.smoothness, local)

    found = {
        "σ² of equation 2": max(abs(sigma_colour**2 / colour - 1), abs(sigma_gradient**2 / gradient - 1)),
        "equation 2, w": _relative(found_w, w),
        "equation 1, R(m)": _prior_error(fill, kernels, device, disparity, prior(disparity, w, *local)),
        "section 5, the propagated map": _relative(kernels.numpy(fill.filled), propagated(*local, w)),
        "section 6, the energy": abs(kernels.number(value) / energy_at(disparity) - 1),
        "section 6, its gradient": _gradient_error(kernels.numpy(slope), disparity, energy_at),
    }
    return {**found, **_local_errors(kernels, device)}


def _prior_error(fill: Propagation, kernels: KernelSet, device: str, disparity: Array, want: float) -> float:
    slope, value = kernels.zeros(disparity.shape, device), kernels.scalar(0.0, device)
    fill.energy(kernels.field(disparity, device), slope, value)
    return abs(kernels.number(value) / want - 1)


def _gradient_error(got: NDArray[np.floating], disparity: Array, energy_at: Callable[[Array], float]) -> float:
    """Against central differences of the printed energy, at some pixels."""
    step, found = 1e-5, []
    for place in ((0, 0), (3, 4), (6, 2), (2, 7)):
        moved = np.zeros_like(disparity)
        moved[place] = step
        slope = (energy_at(disparity + moved) - energy_at(disparity - moved)) / (2 * step)
        found.append(abs(got[place] - slope))
    return float(max(found) / np.abs(got).max())


def _local_errors(kernels: KernelSet, device: str) -> dict[str, float]:
    """Of the row and of the column, in a light field whose rows stand twice as far apart as its columns."""
    lf, bounds, config = wide_columns(), (-1.0, 1.0), exact_config().local
    estimator = LocalEstimator(lf.layout, bounds, config, Device(kernels, device))
    estimator.run(kernels.image(lf.views, device))
    found = {}
    for line, indices, axis, spacing in (("row", lf.row(), 0, 1.0), ("column", lf.column(), 1, 2.0)):
        views = np.stack([lf.image(int(n)) for n in indices]).astype(np.float64)
        views = views.swapaxes(1, 2) if axis else views
        want = local_estimate(views, lf.offsets[list(indices), axis], spacing, bounds, config)
        got = [kernels.numpy(field).astype(np.float64) for field in estimator.by_line[line]]
        want_map, want_coherence = (part.T if axis else part for part in want)
        sure = want_coherence > 0.5
        found[f"section 5, local estimate of the {line}"] = float(np.abs(got[0] - want_map)[sure].max())
        found[f"section 5, coherence of the {line}"] = float(np.abs(got[1] - want_coherence).max())
    return found


def _relative(got: NDArray[np.floating], want: Array) -> float:
    return float(np.abs(got - want).max() / np.abs(want).max())
