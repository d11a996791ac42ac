"""The Warp backend as a GPU runs it, on a CPU: `KERNELS` is that backend.

The package `kernels/warp` is imported a second time. What it asks a device for (`is_cpu`, `is_cuda`) is answered as a
GPU would, so that it takes the paths of a GPU. Memory stays the CPU's. Warp runs each block of threads as fibers
(`wp.config.enable_cpu_blocks`), which take turns: a thread runs until it waits. Native code gets what CUDA has and a
CPU has not, in terms of that: memory that a block shares, barriers, shuffles, votes, atomics.

What this cannot show: rounding of a GPU's own functions, memory that threads reach in another order, time.
"""

import importlib
import importlib.util
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, cast

import warp as wp

from lfgpu import kernels
from lfgpu.contract import KernelSet

NAME = "lfgpu_gpu_blocks"
FOLDER = Path(next(iter(kernels.__path__))) / "warp"
BLOCK = 256  # threads of a block where a launch does not say
PARTS = 8  # blocks that share a sum, instead of 128: threads that take turns take long
ON_HOST = ("asking", "control", "memory", "recording", "sharing", "staging", "streaming", "transport")
"""Modules about memory and streams, for which the device stays what it is."""

# Static lambdas need not be captured by other lambdas. Whole blocks and warps wait, as the kernels are launched with
# multiples of them. A thread that waits too long goes on: the result is wrong then, which a test wants to see.
_PRELUDE = """
    #define __CUDA_ARCH__ 900
    #define __shared__ static
    #define memcpy __builtin_memcpy
    #define alignas(size) __attribute__((aligned(size)))
    struct int4 { int x, y, z, w; };
    struct uint2 { unsigned x, y; };
    struct float2 { float x, y; };
    struct uint4 { unsigned x, y, z, w; };
    struct float4 { float x, y, z, w; };
    static const auto make_int4 = [](int x, int y, int z, int w) { return int4{x, y, z, w}; };
    static const auto min = [](auto a, auto b) { return b < a ? b : a; };
    static const auto max = [](auto a, auto b) { return a < b ? b : a; };
    // Of a number and what is none, the number.
    static const auto fminf = [](float a, float b) { return a != a ? b : b != b ? a : b < a ? b : a; };
    static const auto fmaxf = [](float a, float b) { return a != a ? b : b != b ? a : a < b ? b : a; };
    static const auto __float_as_int = [](float value) { return __builtin_bit_cast(int, value); };
    static const auto __int_as_float = [](int value) { return __builtin_bit_cast(float, value); };
    static const auto __uint_as_float = [](unsigned value) { return __builtin_bit_cast(float, value); };
    static const auto __float2int_rn = [](float value) { return (int)__builtin_rintf(value); };
    static const auto __fdividef = [](float a, float b) { return a / b; };
    static const auto __ldcs = [](auto* place) { return *place; };
    static const auto __ldg = [](auto* place) { return *place; };
    static const auto __byte_perm = [](unsigned x, unsigned y, unsigned selector) {
        const unsigned long long both = (unsigned long long)y << 32 | x;
        unsigned result = 0;
        for (int i = 0; i < 4; ++i) result |= (unsigned)(both >> 8 * (selector >> 4 * i & 7) & 0xff) << 8 * i;
        return result;
    };
    static const auto atomicAdd = [](auto* place, auto value) { const auto old = *place; *place += value; return old; };
    static const auto atomicMax = [](auto* place, auto value) {
        const auto old = *place;
        *place = old < value ? value : old;
        return old;
    };
    static const auto atomicMin = [](auto* place, auto value) {
        const auto old = *place;
        *place = value < old ? value : old;
        return old;
    };
    static int gpu_arrived[33], gpu_turns[33];  // of the block, and of each of its warps
    static unsigned long long gpu_told[2][32][32];  // by turns, so that one wait is enough
    static const auto gpu_wait = [](int group, int members) {
        const int turn = gpu_turns[group];
        if (++gpu_arrived[group] == members) {
            gpu_arrived[group] = 0;
            ++gpu_turns[group];
        }
        for (int tries = 0; gpu_turns[group] == turn && tries < 2000; ++tries) wp_cpu_tile_sync();
    };
    static const auto __syncthreads = []() { gpu_wait(0, WP_TILE_BLOCK_DIM); };
    static const auto __syncwarp = []() { gpu_wait(1 + wp_cpu_get_thread_idx() / 32, 32); };
    // Tells the other lanes of the warp a value, and returns that of lane `from`.
    static const auto gpu_ask = [](auto value, int from) {
        const int warp = wp_cpu_get_thread_idx() / 32, lane = wp_cpu_get_thread_idx() % 32;
        auto& told = gpu_told[gpu_turns[1 + warp] & 1][warp];
        auto answer = value;
        __builtin_memcpy(&told[lane], &value, sizeof(value));
        __syncwarp();
        __builtin_memcpy(&answer, &told[from & 31], sizeof(value));
        return answer;
    };
    static const auto __shfl_xor_sync = [](unsigned, auto value, int mask) {
        return gpu_ask(value, wp_cpu_get_thread_idx() % 32 ^ mask);
    };
    static const auto __shfl_up_sync = [](unsigned, auto value, int by) {
        const int lane = wp_cpu_get_thread_idx() % 32;
        return gpu_ask(value, lane < by ? lane : lane - by);
    };
    static const auto __shfl_down_sync = [](unsigned, auto value, int by) {
        const int lane = wp_cpu_get_thread_idx() % 32;
        return gpu_ask(value, lane + by > 31 ? lane : lane + by);
    };
    static const auto __ballot_sync = [](unsigned, bool yes) {
        const int warp = wp_cpu_get_thread_idx() / 32, turn = gpu_turns[1 + warp] & 1;
        gpu_ask(yes, 0);
        unsigned votes = 0;
        for (int lane = 0; lane < 32; ++lane) votes |= (unsigned)((gpu_told[turn][warp][lane] & 1) << lane);
        return votes;
    };
    static const auto __any_sync = [](unsigned mask, bool yes) { return __ballot_sync(mask, yes) != 0u; };
    // Copies that a thread has begun are made as late as may be: when it waits for them.
    struct gpu_copy { unsigned long to; const void* from; int bytes; };
    static gpu_copy gpu_copies[1024][64];
    static int gpu_begun[1024];
    static const auto __cvta_generic_to_shared = [](const void* place) { return (unsigned long)place; };
    static const auto gpu_begin_copy = [](unsigned long to, const void* from, int bytes) {
        const int thread = wp_cpu_get_thread_idx();
        gpu_copies[thread][gpu_begun[thread]++] = {to, from, bytes};
    };
    static const auto gpu_end_copies = []() {
        int& begun = gpu_begun[wp_cpu_get_thread_idx()];
        while (begun) {
            const gpu_copy& copy = gpu_copies[wp_cpu_get_thread_idx()][--begun];
            __builtin_memset((void*)copy.to, 0, 16);
            __builtin_memcpy((void*)copy.to, copy.from, copy.bytes);
        }
    };
    // Loads so many matrices of 8 rows of 16 bytes, whose places eight lanes each have: row lane / 4, word lane % 4.
    static const auto gpu_load_matrices = [](int count, unsigned* words, unsigned long place) {
        const int lane = wp_cpu_get_thread_idx() % 32;
        for (int i = 0; i < count; ++i) words[i] = ((const unsigned*)gpu_ask(place, i * 8 + lane / 4))[lane % 4];
    };
    // Adds to this lane's four of 16 x 8 sums the products of matrices of half precision that all lanes have parts of:
    // numbers (i, k) of a are in lane i % 8 * 4 + k % 8 / 2, its word i / 8 + k / 8 * 2; (k, j) of b in lane
    // j * 4 + k % 8 / 2, word k / 8; of two in a word the even one is lower. Sums (i, j) are in lane i % 8 * 4 + j / 2.
    static unsigned gpu_factors[2][32][32][6];
    static const auto gpu_multiply = [](int depth, float* sums, const unsigned* a, const unsigned* b) {
        const int warp = wp_cpu_get_thread_idx() / 32, lane = wp_cpu_get_thread_idx() % 32;
        auto& factors = gpu_factors[gpu_turns[1 + warp] & 1][warp];
        for (int i = 0; i < depth / 4; ++i) factors[lane][i] = a[i];
        for (int i = 0; i < depth / 8; ++i) factors[lane][4 + i] = b[i];
        __syncwarp();
        auto half = [](unsigned word, int k) {
            return (float)__builtin_bit_cast(_Float16, (unsigned short)(word >> 16 * (k % 2)));
        };
        for (int s = 0; s < 4; ++s) {
            const int i = lane / 4 + s / 2 * 8, j = lane % 4 * 2 + s % 2;
            for (int k = 0; k < depth; ++k)
                sums[s] += half(factors[i % 8 * 4 + k % 8 / 2][i / 8 + k / 8 * 2], k)
                    * half(factors[j * 4 + k % 8 / 2][4 + k / 8], k);
        }
    };
"""
_POSTLUDE = """
    #undef __CUDA_ARCH__
    #undef __shared__
    #undef alignas
"""

_ROOT = re.compile(r'asm\("sqrt\.approx\.ftz\.f32 %0, %1;" : "=f"\((.*?)\) : "f"\((.*)\)\);')
_MULTIPLY = re.compile(
    r'asm volatile\("mma\.sync\.aligned\.m16n8k(8|16)\.row\.col\.f32\.f16\.f16\.f32 [^;]*;"([^;]*)\);'
)
_BEGIN_COPY = re.compile(
    r'asm volatile\("cp\.async\.cg\.shared\.global \[%0\], \[%1\], 16, %2;"\s*'
    r':: "l"\((.*?)\), "l"\((.*?)\), "r"\((.*?)\) : "memory"\);'
)
_LOAD_MATRICES = re.compile(
    r'asm volatile\("ldmatrix\.sync\.aligned\.m8n8\.x([24])\.shared\.b16 [^"]*"([^;]*) : "l"\((.*?)\)\);'
)
_END_COPIES = 'asm volatile("cp.async.wait_all;" ::: "memory");'


def _multiply(asm: re.Match[str]) -> str:
    """Multiply matrices without tensor cores."""
    sums, factors = (re.findall(rf'"{kind}"\((.*?)\)', asm[2]) for kind in (r"\+f", "r"))
    a, b = (", ".join(some) for some in (factors[: int(asm[1]) // 4], factors[int(asm[1]) // 4 :]))
    values = f"float s[] = {{{', '.join(sums)}}}; const unsigned a_[] = {{{a}}}, b_[] = {{{b}}};"
    back = "".join(f"{place} = s[{k}];" for k, place in enumerate(sums))
    return f"{{ {values} gpu_multiply({asm[1]}, s, a_, b_); {back} }}"


def _load_matrices(asm: re.Match[str]) -> str:
    """Load the parts that a lane has of matrices."""
    back = "".join(f"{place} = w[{k}];" for k, place in enumerate(re.findall(r'"=r"\((.*?)\)', asm[2])))
    return f"{{ unsigned w[{asm[1]}]; gpu_load_matrices({asm[1]}, w, {asm[3]}); {back} }}"


def _native(code: str) -> Callable[[Callable[..., Any]], Any]:
    code = _MULTIPLY.sub(_multiply, _ROOT.sub(r"\1 = __builtin_sqrtf(\2);", code))
    code = _LOAD_MATRICES.sub(_load_matrices, code)
    code = _BEGIN_COPY.sub(r"gpu_begin_copy(\1, \2, \3);", code).replace(_END_COPIES, "gpu_end_copies();")
    return cast("Callable[[Callable[..., Any]], Any]", wp.func_native(_PRELUDE + code + _POSTLUDE))


class _Loader(SourceFileLoader):
    """Imports a file of the Warp backend with the answers of a GPU; no compiled copy is kept or used."""

    def get_code(self, fullname: str) -> Any:
        text = Path(self.path).read_text(encoding="utf-8")
        if Path(self.path).stem not in ON_HOST:
            text = re.sub(r"\b[\w.]+\.is_cpu\b", "False", text)
            text = re.sub(r"\b[\w.]+\.is_cuda\b", "True", text)
            text = re.sub(r"\((\w+ := [\w.()]+)\)\.is_cuda\b", r"(\1, True)[1]", text)
            text = text.replace("wp.func_native(", "_native(")
        text = re.sub(r"^(_?PARTS) = 128\b", rf"\1 = {PARTS}", text, flags=re.MULTILINE)
        text = re.sub(r'"lfgpu_(?!room)', f'"{NAME}_', text)
        return compile(text, self.path, "exec", dont_inherit=True)

    def exec_module(self, module: ModuleType) -> None:
        vars(module)["_native"] = _native
        super().exec_module(module)


class _Finder(MetaPathFinder):
    """Finds the second copy of the package."""

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        package, _, leaf = name.partition(".")
        if package != NAME:
            return None
        file = FOLDER / (f"{leaf}.py" if leaf else "__init__.py")
        if not file.is_file():
            return None
        loader = _Loader(name, str(file))
        return importlib.util.spec_from_file_location(
            name, file, loader=loader, submodule_search_locations=None if leaf else [str(FOLDER)]
        )


def load() -> KernelSet:
    """The backend. Its work has to be done `in_blocks`."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())  # before the one that would find the package as it is
    return cast("KernelSet", importlib.import_module(NAME).KERNELS)


@contextmanager
def in_blocks() -> Iterator[None]:
    """Warp launches blocks of threads on the CPU meanwhile, of `BLOCK` where a launch does not say."""
    before, launch = wp.config.enable_cpu_blocks, wp.launch

    def of_blocks(*arguments: Any, block_dim: int | None = None, **options: Any) -> Any:
        return launch(*arguments, block_dim=BLOCK if block_dim is None else block_dim, **options)

    wp.config.enable_cpu_blocks, wp.launch = True, of_blocks
    try:
        yield
    finally:
        wp.config.enable_cpu_blocks, wp.launch = before, launch
