"""The gather without its arithmetic, for the benchmark: corners are only read, at known places."""

from functools import lru_cache
from typing import Any

import warp as wp

from hsvaos.kernels.device import in_vectors, launch

wp.set_module_options({"enable_backward": False})

_READ = """
    unsigned long long sum = 0;
    const unsigned* from = (const unsigned*)words.data;
    const int* at = (const int*)places.data;
    for (int turn = 0; turn < repeats; ++turn) {
        // gather instructions are slower than plain loads on many processors
        #pragma clang loop vectorize(disable) unroll_count(8)
        for (int i = 0; i < count; ++i) {
            unsigned long long upper, lower;
            __builtin_memcpy(&upper, from + at[i], 8);
            __builtin_memcpy(&lower, from + at[i] + row, 8);
            sum += upper ^ lower;
        }
        __asm__ volatile("" ::: "memory");  // read again each time
    }
    sums.data[segment] = sum;
"""


@lru_cache
def _read_kernel(on_cpu: bool) -> Any:
    if on_cpu:

        @wp.func_native(_READ)
        def read_segment(
            segment: int,
            row: int,
            count: int,
            repeats: int,
            words: wp.array(dtype=wp.uint32),
            places: wp.array(dtype=int),
            sums: wp.array(dtype=wp.uint64),
        ): ...

    else:  # eight bytes at an odd word cannot be read at once there

        @wp.func
        def read_segment(
            segment: int,
            row: int,
            count: int,
            repeats: int,
            words: wp.array(dtype=wp.uint32),
            places: wp.array(dtype=int),
            sums: wp.array(dtype=wp.uint64),
        ):
            total = wp.uint64(0)
            for turn in range(repeats):
                for i in range(count):
                    at = places[(i + segment + turn) % count]
                    left = wp.uint64(words[at] ^ words[at + row])
                    right = wp.uint64(words[at + 1] ^ words[at + row + 1])
                    total += left + (right << wp.uint64(32))
            sums[segment] = total

    @wp.kernel(module="unique", enable_backward=False)
    def read_kernel(
        offset: int,
        band: int,
        row: int,
        count: int,
        repeats: int,
        words: wp.array(dtype=wp.uint32),
        places: wp.array(dtype=int),
        sums: wp.array(dtype=wp.uint64),
    ):
        read_segment(wp.tid() + offset, row, count, repeats, words, places, sums)

    return read_kernel


def read_corners(words: Any, row: int, places: Any, repeats: int, sums: Any) -> None:
    """Read the four pixels of every place, again and again, and sum up what the rows differ in.

    Args:
        words: Warp array of uint32, a packed photo.
        row: Pixels from one row to the next.
        places: Warp array of int32, the upper left pixels.
        repeats: How often each segment reads all places.
        sums: Warp array of uint64, one a segment, written: `repeats` times the sum over places of
            (a xor c) + (b xor d) 2^32, modulo 2^64, of the corners a b above c d.
    """
    inputs = [row, places.size, repeats, words, places, sums]
    launch(_read_kernel(in_vectors(words.device)), sums.size, inputs, words.device, 1)
