"""Semi-global matching; `kernels/reference/semi_global.py` says which.

Paths that lie side by side are followed together, pixel by pixel. A path has cost nothing before it begins: then
the formula of its further pixels gives the first one's costs as they are.
"""

from typing import Any

import warp as wp

from .cost_volume import code
from .memory import pixel_type
from .threads import in_slices, launch, load, once, slices

wp.set_module_options({"enable_backward": False})

_DIRECTIONS = ((1, -1), (1, 0), (1, 1), (0, 1), (-1, -1), (-1, 0), (-1, 1), (0, -1))  # (dy, dx)
_BLOCK = 32  # paths that a CPU follows together
_CHUNK = 16  # columns of a row that it turns at a time, so that paths along rows lie side by side
_WARP = 32
_GROUPS = 32  # threads that share a path on a GPU, at most

_FOLLOW_BLOCKS = """
    // What a change by one, and by more, costs between two pixels.
    auto step_costs = [&](int p, int q, float& small_out, float& large_out) {
        float difference = 0.f;
        for (int c = 0; c < CHANNELS; ++c) difference += fabsf(image.data[p].c[c] - image.data[q].c[c]);
        const float likeness = expf(-difference / (CHANNELS * contrast));
        small_out = scale.data[p] * small * (likeness > 0.2f ? likeness : 0.2f);
        large_out = scale.data[p] * (large * likeness > 1.2f * small ? large * likeness : 1.2f * small);
    };

    const int count = volume.shape[0], height = volume.shape[1], width = volume.shape[2];
    const size_t size = (size_t)height * width;
    float* const before = room.data;  // what the paths cost up to the pixels before, [count + 1][BLOCK]
    float* const turned = before + (count + 1) * BLOCK;  // [count][CHUNK][BLOCK]
    float least[BLOCK], smalls[BLOCK], larges[BLOCK];

    // One pixel further for paths begin to end: `costs` and `to` have a slice every `stride` numbers.
    auto advance = [&](const float* costs, float* to, size_t stride, bool adds, int begin, int end) {
        float low[BLOCK], least_now[BLOCK];
        for (int j = begin; j < end; ++j) {
            low[j] = INFINITY;
            least_now[j] = INFINITY;
            larges[j] += least[j];
        }
        for (int l = 0; l < count; ++l) {
            float* const b = before + l * BLOCK;
            const float* const c = costs + l * stride;
            float* const sum = to + l * stride;
    #pragma clang loop vectorize(assume_safety)
            for (int j = begin; j < end; ++j) {
                const float here = b[j], high = b[j + BLOCK];
                const float one = (low[j] < high ? low[j] : high) + smalls[j];
                const float change = one < larges[j] ? one : larges[j];
                const float cost = c[j] + ((here < change ? here : change) - least[j]);
                low[j] = here;
                b[j] = cost;
                least_now[j] = cost < least_now[j] ? cost : least_now[j];
                sum[j] = adds ? sum[j] + cost : cost;
            }
        }
        for (int j = begin; j < end; ++j) least[j] = least_now[j];
    };

    for (int block = first; block < last; ++block) {
        for (int i = 0; i < count * BLOCK; ++i) before[i] = 0.f;
        for (int j = 0; j < BLOCK; ++j) {
            before[count * BLOCK + j] = INFINITY;
            least[j] = 0.f;
        }
        if (dy != 0) {
            for (int i = 0; i < height; ++i) {
                const int y = dy > 0 ? i : height - 1 - i;
                // Where the first path of the block is, in the frame or not: no path comes back once it has left.
                const int x0 = block * BLOCK + dx * i - (dx > 0 ? height - 1 : 0);
                const int begin = x0 < 0 ? -x0 : 0, end = width - x0 < BLOCK ? width - x0 : BLOCK;
                for (int j = begin; j < end; ++j) {
                    const int x = x0 + j, p = y * width + x;
                    smalls[j] = larges[j] = 0.f;
                    if (i > 0 && x - dx >= 0 && x - dx < width)
                        step_costs(p, p - dy * width - dx, smalls[j], larges[j]);
                }
                const long long place = (long long)y * width + x0;
                if (begin == 0 && end == BLOCK)
                    advance(volume.data + place, sums.data + place, size, adds, 0, BLOCK);
                else if (begin < end)
                    advance(volume.data + place, sums.data + place, size, adds, begin, end);
            }
            continue;
        }
        const int y0 = block * BLOCK, rows = height - y0 < BLOCK ? height - y0 : BLOCK;
        for (int done = 0; done < width; done += CHUNK) {
            const int columns = width - done < CHUNK ? width - done : CHUNK;
            const int x0 = dx > 0 ? done : width - done - columns;
            const size_t corner = (size_t)y0 * width + x0;
            for (int l = 0; l < count; ++l)
                for (int j = 0; j < rows; ++j)
                    for (int i = 0; i < columns; ++i)
                        turned[(l * CHUNK + i) * BLOCK + j] = volume.data[l * size + corner + j * width + i];
            for (int k = 0; k < columns; ++k) {
                const int i = dx > 0 ? k : columns - 1 - k;
                for (int j = 0; j < rows; ++j) {
                    const int p = (y0 + j) * width + x0 + i;
                    smalls[j] = larges[j] = 0.f;
                    if (done + k > 0) step_costs(p, p - dx, smalls[j], larges[j]);
                }
                float* const column = turned + i * BLOCK;
                if (rows == BLOCK)
                    advance(column, column, CHUNK * BLOCK, false, 0, BLOCK);
                else
                    advance(column, column, CHUNK * BLOCK, false, 0, rows);
            }
            for (int l = 0; l < count; ++l)
                for (int j = 0; j < rows; ++j) {
                    float* const sum = sums.data + l * size + corner + j * width;
                    for (int i = 0; i < columns; ++i)
                        sum[i] = (adds ? sum[i] : 0.f) + turned[(l * CHUNK + i) * BLOCK + j];
                }
        }
    }
"""

# On a GPU, the threads of a block have PATHS paths, each of them EACH neighbouring disparities of one path. They tell
# each other the least cost and those at the ends of what they have. A diagonal that leaves the frame at one side goes
# on, as another path, at the other side of the next row: so all blocks have the same work. What is needed AHEAD steps
# later is on its way from memory meanwhile.

_FOLLOW_PATHS = """
    __shared__ float leasts[2][GROUPS * PATHS / 32][PATHS], firsts[2][GROUPS][PATHS], lasts[2][GROUPS][PATHS];
    const int count = volume.shape[0], height = volume.shape[1], width = volume.shape[2];
    const int paths = dy ? width : height, steps = dy ? height : width;
    const long long size = (long long)height * width;
    const int lane = thread % PATHS, group = thread / PATHS, groups = threads / PATHS, warps = threads / 32;
    const int path = min(block * PATHS + lane, paths - 1), label = group * EACH;
    const bool counts = block * PATHS + lane < paths;  // else it follows the last one too, and writes nothing
    const float* const costs = volume.data + label * size;
    float* const to = sums.data + label * size;

    int x = dy ? path : (dx > 0 ? 0 : width - 1), y = dy ? (dy > 0 ? 0 : height - 1) : path;
    int next_x = x, next_y = y;
    auto go = [&](int& x, int& y) {
        x += dx;
        y += dy;
        if (dy) x = x == width ? 0 : x < 0 ? width - 1 : x;
    };
    float cost[AHEAD][EACH], sum[AHEAD][EACH], color[AHEAD][CHANNELS], scales[AHEAD];
    auto fetch = [&](int slot) {
        const int p = next_y * width + next_x;
    #pragma unroll
        for (int k = 0; k < EACH; ++k) {
            cost[slot][k] = label + k < count ? costs[k * size + p] : INFINITY;
            if (adds && label + k < count) sum[slot][k] = to[k * size + p];
        }
        for (int c = 0; c < CHANNELS; ++c) color[slot][c] = image.data[p].c[c];
        scales[slot] = scale.data[p];
        go(next_x, next_y);
    };
    #pragma unroll
    for (int slot = 0; slot < AHEAD; ++slot)
        if (slot < steps) fetch(slot);

    float before[EACH], before_color[CHANNELS], least = 0.f, below = 0.f, above = 0.f;
    for (int base = 0; base < steps; base += AHEAD) {
    #pragma unroll
        for (int slot = 0; slot < AHEAD; ++slot) {
            const int i = base + slot;
            if (i >= steps) break;
            if (i == 0 || (dy && x == (dx > 0 ? 0 : dx < 0 ? width - 1 : -1))) {
    #pragma unroll
                for (int k = 0; k < EACH; ++k) before[k] = 0.f;
                for (int c = 0; c < CHANNELS; ++c) before_color[c] = 0.f;
                least = below = above = 0.f;
            }
            float difference = 0.f;
            for (int c = 0; c < CHANNELS; ++c) {
                difference += fabsf(color[slot][c] - before_color[c]);
                before_color[c] = color[slot][c];
            }
            const float likeness = expf(-difference / (CHANNELS * contrast));
            const float one = scales[slot] * small * fmaxf(likeness, 0.2f);
            const float most = least + scales[slot] * fmaxf(large * likeness, 1.2f * small);
            float least_here = INFINITY, low = below;
            const int p = y * width + x;
    #pragma unroll
            for (int k = 0; k < EACH; ++k) {
                const float here = before[k], high = k + 1 < EACH ? before[k + 1] : above;
                const float change = fminf(fminf(low, high) + one, most);
                before[k] = cost[slot][k] + (fminf(here, change) - least);
                low = here;
                least_here = fminf(least_here, before[k]);
                if (counts && label + k < count) to[k * size + p] = adds ? sum[slot][k] + before[k] : before[k];
            }
            go(x, y);
            if (i + AHEAD < steps) fetch(slot);

            for (int far = PATHS; far < 32; far *= 2)
                least_here = fminf(least_here, __shfl_xor_sync(~0u, least_here, far));
            const int side = i & 1;  // what was told a step ago may still be read
            if (thread % 32 < PATHS) leasts[side][thread / 32][lane] = least_here;
            firsts[side][group][lane] = before[0];
            lasts[side][group][lane] = before[EACH - 1];
            __syncthreads();
            least = INFINITY;
            for (int warp = 0; warp < warps; ++warp) least = fminf(least, leasts[side][warp][lane]);
            below = group > 0 ? lasts[side][group - 1][lane] : INFINITY;
            above = group + 1 < groups ? firsts[side][group + 1][lane] : INFINITY;
        }
    }
"""


@once
def _blocks_kernel(channels: int) -> Any:
    """For a CPU: some blocks of paths."""
    pixel = pixel_type(channels)

    @wp.func_native(code(_FOLLOW_BLOCKS, CHANNELS=channels, BLOCK=_BLOCK, CHUNK=_CHUNK))
    def follow(
        volume: wp.array3d(dtype=float),
        image: wp.array2d(dtype=pixel),
        scale: wp.array2d(dtype=float),
        small: float,
        large: float,
        contrast: float,
        dy: int,
        dx: int,
        adds: bool,
        first: int,
        last: int,
        room: wp.array(dtype=float),
        sums: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_semi_global_{channels}", enable_backward=False)
    def blocks_kernel(
        volume: wp.array3d(dtype=float),
        image: wp.array2d(dtype=pixel),
        scale: wp.array2d(dtype=float),
        small: float,
        large: float,
        contrast: float,
        dy: int,
        dx: int,
        adds: bool,
        first: int,
        last: int,
        room: wp.array(dtype=float),
        sum_out: wp.array3d(dtype=float),
    ):
        follow(volume, image, scale, small, large, contrast, dy, dx, adds, first, last, room, sum_out)

    return blocks_kernel


@once
def _paths_kernel(channels: int, each: int, paths: int) -> Any:
    """For a GPU: `paths` paths on each block, `each` disparities on each thread."""
    pixel, ahead = pixel_type(channels), max(1, 16 // each)

    @wp.func_native(code(_FOLLOW_PATHS, CHANNELS=channels, EACH=each, PATHS=paths, GROUPS=_GROUPS, AHEAD=ahead))
    def follow(
        volume: wp.array3d(dtype=float),
        image: wp.array2d(dtype=pixel),
        scale: wp.array2d(dtype=float),
        small: float,
        large: float,
        contrast: float,
        dy: int,
        dx: int,
        adds: bool,
        block: int,
        thread: int,
        threads: int,
        sums: wp.array3d(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_gpu_semi_global_{channels}_{each}_{paths}", enable_backward=False)
    def paths_kernel(
        volume: wp.array3d(dtype=float),
        image: wp.array2d(dtype=pixel),
        scale: wp.array2d(dtype=float),
        small: float,
        large: float,
        contrast: float,
        dy: int,
        dx: int,
        adds: bool,
        threads: int,
        sum_out: wp.array3d(dtype=float),
    ):
        i = wp.tid()
        block = i / threads
        follow(volume, image, scale, small, large, contrast, dy, dx, adds, block, i - block * threads, threads, sum_out)

    return paths_kernel


def semi_global(
    volume: Any, image: Any, penalty_scale: Any, *, small: float, large: float, contrast: float, sum_out: Any
) -> None:
    follow = _on_cpu if volume.device.is_cpu else _on_gpu
    for k, (dy, dx) in enumerate(_DIRECTIONS):
        inputs = [volume, image, penalty_scale, small, large, contrast, dy, dx, k > 0]
        follow(inputs, image.dtype._length_, dy, dx, sum_out)


def _on_cpu(inputs: list[Any], channels: int, dy: int, dx: int, sum_out: Any) -> None:
    (count, height, width), device = sum_out.shape, sum_out.device
    kernel = _blocks_kernel(channels)
    load(device, kernel)
    paths = width + abs(dx) * (height - 1) if dy else height
    blocks = -(-paths // _BLOCK)
    room = wp.empty((len(slices(device, blocks)), (count + 1 + count * _CHUNK) * _BLOCK), dtype=float, device=device)

    def some_blocks(part: int, first: int, last: int) -> None:
        launch(kernel, 1, [*inputs, first, last, room[part]], [sum_out], device=device)

    in_slices(device, blocks, some_blocks)


def _on_gpu(inputs: list[Any], channels: int, dy: int, dx: int, sum_out: Any) -> None:
    count, height, width = sum_out.shape
    # Fewer paths on a block along rows: what these read lies far apart, and all processors have to help with it.
    paths, each = 8 if dy else 4, 4
    while each * _GROUPS < count:
        each *= 2
    groups = -(-count // each)
    threads = -(-groups * paths // _WARP) * _WARP
    blocks = -(-(width if dy else height) // paths)
    kernel = _paths_kernel(channels, each, paths)
    launch(kernel, blocks * threads, [*inputs, threads], [sum_out], device=sum_out.device, block_dim=threads)
