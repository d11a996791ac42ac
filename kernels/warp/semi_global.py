"""Semi-global matching; `kernels/reference/semi_global.py` says which.

Paths that lie side by side are followed together, pixel by pixel. A path has cost nothing before it begins: then
the formula of its further pixels gives the first one's costs as they are.

A step along a path waits for the one before, whatever else a GPU could do meanwhile. So there paths of several
directions are followed at the same time, each direction with a volume of its own, which are added up in order. In these
volumes [y, x, l] the costs of a pixel lie side by side: a warp, which has a path, reads and writes them as a whole.
"""

from typing import Any

import warp as wp

from .cost_volume import code
from .memory import pixel_type
from .threads import check_size, in_slices, launch, load, once, slices

wp.set_module_options({"enable_backward": False})

_DIRECTIONS = ((1, -1), (1, 0), (1, 1), (0, 1), (-1, -1), (-1, 0), (-1, 1), (0, -1))  # (dy, dx)
_BLOCK = 32  # paths that a CPU follows together
_CHUNK = 16  # columns of a row that it turns at a time, so that paths along rows lie side by side
_WARP = 32
_AHEAD = 4  # steps along a path, whose costs are on their way to a GPU's threads
_WARPS = 4  # of a block of a GPU, each with a path
_TILE = 32  # pixels of a row and disparities of them, that a GPU turns at a time
_TURNING = 256  # threads that do so
_ROOM = 2**29  # bytes: volumes that a GPU needs besides, at most, unless two are larger

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

# On a GPU a warp has a path, each of its threads EACH neighbouring disparities. They tell each other the least cost and
# those at the ends of what they have. A diagonal that leaves the frame at one side goes on, as another path, at the
# other side of the next row: so all warps have the same work. What is needed AHEAD steps later is on its way from
# memory meanwhile. The directions from `first` to before `last` are followed now.

_FOLLOW_PATH = """
    constexpr int downwards[] = {DOWNWARDS}, sideways[] = {SIDEWAYS};
    const int height = volume.shape[0], width = volume.shape[1], count = volume.shape[2];
    int direction = first;
    for (; direction + 1 < last; ++direction) {  // whose paths come one after the other
        const int paths = downwards[direction] ? width : height;
        if (path < paths) break;
        path -= paths;
    }
    const int dy = downwards[direction], dx = sideways[direction], steps = dy ? height : width, label = lane * EACH;
    if (path >= (dy ? width : height)) return;  // a whole warp, the last one
    const size_t size = (size_t)height * width * count;
    const float* const costs = volume.data + label;
    const float2* const penalties = (const float2*)steps_to.data + (size_t)direction * height * width;
    float* const to = room.data + (direction - first) * size + label;

    int x = dy ? path : (dx > 0 ? 0 : width - 1), p = (dy ? (dy > 0 ? 0 : height - 1) : path) * width + x;
    bool begins = true;
    float cost[AHEAD][EACH];
    float2 penalty[AHEAD];
    unsigned places[AHEAD];
    bool begin[AHEAD];
    auto fetch = [&](int slot) {
        const float* const from = costs + (size_t)(unsigned)p * count;
    #pragma unroll
        for (int k = 0; k < EACH; ++k) cost[slot][k] = label + k < count ? from[k] : INFINITY;
        penalty[slot] = penalties[(unsigned)p];
        places[slot] = p;
        begin[slot] = begins;
        x += dx;
        p += dy * width + dx;
        begins = dy && (x == width || x < 0);
        if (begins) {
            p -= dx * width;
            x = dx > 0 ? 0 : width - 1;
        }
    };
    #pragma unroll
    for (int slot = 0; slot < AHEAD; ++slot)
        if (slot < steps) fetch(slot);

    float before[EACH], least = 0.f, below = 0.f, above = 0.f;
    for (int base = 0; base < steps; base += AHEAD) {
    #pragma unroll
        for (int slot = 0; slot < AHEAD; ++slot) {
            if (base + slot >= steps) break;
            if (begin[slot]) {
    #pragma unroll
                for (int k = 0; k < EACH; ++k) before[k] = 0.f;
                least = below = above = 0.f;
            }
            const float one = penalty[slot].x, most = least + penalty[slot].y;
            float least_here = INFINITY, low = below;
            float* const out = to + (size_t)places[slot] * count;
    #pragma unroll
            for (int k = 0; k < EACH; ++k) {
                const float here = before[k], high = k + 1 < EACH ? before[k + 1] : above;
                const float change = fminf(fminf(low, high) + one, most);
                before[k] = cost[slot][k] + (fminf(here, change) - least);
                low = here;
                least_here = fminf(least_here, before[k]);
                if (label + k < count) out[k] = before[k];
            }
            if (base + slot + AHEAD < steps) fetch(slot);

            for (int far = 1; far < 32; far *= 2) least_here = fminf(least_here, __shfl_xor_sync(~0u, least_here, far));
            least = least_here;
            const float last_below = __shfl_up_sync(~0u, before[EACH - 1], 1);
            const float first_above = __shfl_down_sync(~0u, before[0], 1);
            below = lane > 0 ? last_below : INFINITY;
            above = lane < 31 ? first_above : INFINITY;
        }
    }
"""

# What a change by one, and by more, costs at each pixel of a path, in all directions; nothing that begins a path
# changes.

_STEP_COSTS = """
    constexpr int downwards[] = {DOWNWARDS}, sideways[] = {SIDEWAYS};
    const int height = image.shape[0], width = image.shape[1], p = y * width + x;
    const auto color = image.data[p];
    #pragma unroll
    for (int k = 0; k < 8; ++k) {
        const int row = y - downwards[k], column = x - sideways[k];
        float difference = 0.f;
        if ((unsigned)row < (unsigned)height && (unsigned)column < (unsigned)width) {
            const auto other = image.data[row * width + column];
            for (int c = 0; c < CHANNELS; ++c) difference += fabsf(color.c[c] - other.c[c]);
        }
        const float likeness = expf(-difference / (CHANNELS * contrast));
        float* const out = steps_to.data + 2 * ((size_t)k * height * width + p);
        out[0] = scale.data[p] * small * fmaxf(likeness, 0.2f);
        out[1] = scale.data[p] * fmaxf(large * likeness, 1.2f * small);
    }
"""

# Between volumes [l, y, x] and [y, x, l], tile by tile. Sums are put together in the order in which one direction after
# the other would add to them.

_TURN = """
    __shared__ float tile[TILE][TILE + 1];
    const int count = volume.shape[0], height = volume.shape[1], width = volume.shape[2];
    const int columns = (width + TILE - 1) / TILE, parts = (count + TILE - 1) / TILE;
    const int y = block / (columns * parts), place = block - y * columns * parts;
    const int left = place / parts * TILE, first = place % parts * TILE;
    const size_t size = (size_t)height * width;
    float* const slices = volume.data + (size_t)y * width;
    const size_t row = ((size_t)y * width + left) * count + first;
    if (volumes == 0) {  // from slices
        for (int i = thread; i < TILE * TILE; i += TURNING) {
            const int l = i / TILE, x = i % TILE;
            if (first + l < count && left + x < width) tile[l][x] = slices[(first + l) * size + left + x];
        }
        __syncthreads();
        for (int i = thread; i < TILE * TILE; i += TURNING) {
            const int x = i / TILE, l = i % TILE;
            if (first + l < count && left + x < width) turned.data[row + (size_t)x * count + l] = tile[l][x];
        }
        return;
    }
    for (int i = thread; i < TILE * TILE; i += TURNING) {
        const int x = i / TILE, l = i % TILE;
        if (first + l >= count || left + x >= width) continue;
        const float* const costs = turned.data + row + (size_t)x * count + l;
        float sum = adds ? slices[(first + l) * size + left + x] : 0.f;
    #pragma unroll 8
        for (int k = 0; k < volumes; ++k) sum += costs[k * size * count];
        tile[l][x] = sum;
    }
    __syncthreads();
    for (int i = thread; i < TILE * TILE; i += TURNING) {
        const int l = i / TILE, x = i % TILE;
        if (first + l < count && left + x < width) slices[(first + l) * size + left + x] = tile[l][x];
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


_STEPS = {
    name: ", ".join(map(str, steps))
    for name, steps in zip(("DOWNWARDS", "SIDEWAYS"), zip(*_DIRECTIONS, strict=True), strict=True)
}


@once
def _step_costs_kernel(channels: int) -> Any:
    pixel = pixel_type(channels)

    @wp.func_native(code(_STEP_COSTS, CHANNELS=channels, **_STEPS))
    def step_costs(
        image: wp.array2d(dtype=pixel),
        scale: wp.array2d(dtype=float),
        small: float,
        large: float,
        contrast: float,
        y: int,
        x: int,
        steps_to: wp.array(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_gpu_semi_global_steps_{channels}", enable_backward=False)
    def step_costs_kernel(
        image: wp.array2d(dtype=pixel),
        scale: wp.array2d(dtype=float),
        small: float,
        large: float,
        contrast: float,
        width: int,
        steps_to_out: wp.array(dtype=float),
    ):
        i = wp.tid()
        y = i / width
        step_costs(image, scale, small, large, contrast, y, i - y * width, steps_to_out)

    return step_costs_kernel


@once
def _path_kernel(each: int) -> Any:
    """For a GPU: `each` disparities on each thread."""

    @wp.func_native(code(_FOLLOW_PATH, EACH=each, AHEAD=max(1, _AHEAD // each), **_STEPS))
    def follow(
        volume: wp.array3d(dtype=float),
        steps_to: wp.array(dtype=float),
        first: int,
        last: int,
        path: int,
        lane: int,
        room: wp.array(dtype=float),
    ): ...

    @wp.kernel(module=f"lfgpu_gpu_semi_global_{each}", enable_backward=False)
    def path_kernel(
        volume: wp.array3d(dtype=float),
        steps_to: wp.array(dtype=float),
        first: int,
        last: int,
        room_out: wp.array(dtype=float),
    ):
        i = wp.tid()
        path = i / wp.static(_WARP)
        follow(volume, steps_to, first, last, path, i % wp.static(_WARP), room_out)

    return path_kernel


@wp.func_native(code(_TURN, TILE=_TILE, TURNING=_TURNING))
def _turn(
    volume: wp.array3d(dtype=float),
    turned: wp.array(dtype=float),
    volumes: int,
    adds: bool,
    block: int,
    thread: int,
): ...


@wp.kernel(module="lfgpu_gpu_semi_global_turn", enable_backward=False)
def _turn_kernel(volume: wp.array3d(dtype=float), turned: wp.array(dtype=float), volumes: int, adds: bool):
    """A volume turned, or the sum of so many that are turned back."""
    i = wp.tid()
    block = i / wp.static(_TURNING)
    _turn(volume, turned, volumes, adds, block, i - block * wp.static(_TURNING))


def semi_global(
    volume: Any, image: Any, penalty_scale: Any, *, small: float, large: float, contrast: float, sum_out: Any
) -> None:
    if not volume.device.is_cpu:
        _on_gpu(volume, [image, penalty_scale, small, large, contrast], sum_out)
        return
    for k, (dy, dx) in enumerate(_DIRECTIONS):
        inputs = [volume, image, penalty_scale, small, large, contrast, dy, dx, k > 0]
        _on_cpu(inputs, image.dtype._length_, dy, dx, sum_out)


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


def _on_gpu(volume: Any, inputs: list[Any], sum_out: Any) -> None:
    (count, height, width), device, image = sum_out.shape, sum_out.device, inputs[0]
    size, pixels = sum_out.size, height * width
    room = _room_of(sum_out)
    steps_to, costs, turned = room[: 16 * pixels], room[16 * pixels :][:size], room[16 * pixels + size :]
    as_turned = wp.array(ptr=costs.ptr, dtype=float, shape=(height, width, count), device=device, copy=False)
    launch(_step_costs_kernel(image.dtype._length_), pixels, [*inputs, width], [steps_to], device=device)
    turning = height * -(-width // _TILE) * -(-count // _TILE) * _TURNING
    check_size(turning)
    options = {"device": device, "block_dim": _TURNING}
    launch(_turn_kernel, turning, [volume, costs, 0, False], **options)
    kernel, at_once = _path_kernel(-(-count // _WARP)), len(turned) // size
    for first in range(0, len(_DIRECTIONS), at_once):
        some = _DIRECTIONS[first : first + at_once]
        paths = sum(width if dy else height for dy, _ in some)
        threads = -(-paths // _WARPS) * _WARPS * _WARP
        inputs = [as_turned, steps_to, first, first + len(some)]
        launch(kernel, threads, inputs, [turned], device=device, block_dim=_WARPS * _WARP)
        launch(_turn_kernel, turning, [sum_out, turned, len(some), first > 0], **options)


def _room_of(sum_out: Any) -> Any:
    """What changes cost; turned volumes, of the costs and of all directions or of as many as there is room for, but one
    at least.

    It lives as long as the sums. It is made when it is first needed, as captured work must not allocate.
    """
    if not hasattr(sum_out, "lfgpu_room"):
        count, size = len(_DIRECTIONS), sum_out.size
        volumes = 1 + min(count, max(1, _ROOM // (4 * size) - 1))
        room = 2 * count * (size // sum_out.shape[0]) + volumes * size
        sum_out.lfgpu_room = wp.empty(room, dtype=float, device=sum_out.device)
    return sum_out.lfgpu_room
