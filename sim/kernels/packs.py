"""Sixteen vertices of a single world at once on a CPU: to and from the lanes.

With one world there is one lane. There, sixteen constraints of one colour, which share no vertex, or sixteen successive
vertices take the lanes instead: a *pack*. Vertices lie in memory as ``vec3`` one after the other; a pack has them as
``lanes`` has sixteen worlds: the sixteen x, then the y, then the z. The way from one to the other is what a pack costs:
a vector that was stored element by element cannot be loaded at once, and waiting for it took as long as all the rest.
So rows are transposed in registers, by shuffles that Warp has no words for.

A pack of constraints that is not full repeats one: the repetition computes and stores the same.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.lanes import scalars, vectors

PACK = 16
"""Vertices or constraints in a pack."""

packed_int = wp.types.vector(length=PACK, dtype=wp.int32)
packed_float = scalars(PACK)
packed_vector = vectors(PACK)

_TYPES = """
typedef float Pair __attribute__((ext_vector_type(2), aligned(4)));
typedef float Row __attribute__((ext_vector_type(4)));
typedef float Lanes __attribute__((ext_vector_type(16)));
typedef float Stored __attribute__((ext_vector_type(16), aligned(4)));
"""

# Rows k, k + 4, k + 8 and k + 12 side by side make four vectors, which are transposed in blocks of four by four.
_TO_LANES = """
#define SIDE_BY_SIDE(k) __builtin_shufflevector( \
    __builtin_shufflevector(rows[k], rows[k + 4], 0, 1, 2, 3, 4, 5, 6, 7), \
    __builtin_shufflevector(rows[k + 8], rows[k + 12], 0, 1, 2, 3, 4, 5, 6, 7), \
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
Lanes a = SIDE_BY_SIDE(0), b = SIDE_BY_SIDE(1), c = SIDE_BY_SIDE(2), d = SIDE_BY_SIDE(3);
#undef SIDE_BY_SIDE
Lanes ab = __builtin_shufflevector(a, b, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
Lanes cd = __builtin_shufflevector(c, d, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
Lanes zab = __builtin_shufflevector(a, b, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
Lanes zcd = __builtin_shufflevector(c, d, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
wp::vec_t<48, float> lanes;
*(Stored*)&lanes.c[0] = __builtin_shufflevector(ab, cd, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
*(Stored*)&lanes.c[16] = __builtin_shufflevector(ab, cd, 2, 3, 18, 19, 6, 7, 22, 23, 10, 11, 26, 27, 14, 15, 30, 31);
*(Stored*)&lanes.c[32] = __builtin_shufflevector(zab, zcd, 0, 1, 16, 17, 4, 5, 20, 21, 8, 9, 24, 25, 12, 13, 28, 29);
return lanes;
"""

_GATHER = f"""
{_TYPES}
Row rows[16];
#pragma unroll
for (int k = 0; k < 16; ++k) {{
    const float* from = values.data[index.c[k]].c;
    Pair xy = *(const Pair*)from;
    Pair z = {{from[2], from[2]}};
    rows[k] = __builtin_shufflevector(xy, z, 0, 1, 2, 3);
}}
{_TO_LANES}
"""

_SCATTER = f"""
{_TYPES}
Lanes x = *(const Stored*)&lanes.c[0], y = *(const Stored*)&lanes.c[16], z = *(const Stored*)&lanes.c[32];
Lanes low = __builtin_shufflevector(x, y, 0, 16, 1, 17, 4, 20, 5, 21, 8, 24, 9, 25, 12, 28, 13, 29);
Lanes high = __builtin_shufflevector(x, y, 2, 18, 3, 19, 6, 22, 7, 23, 10, 26, 11, 27, 14, 30, 15, 31);
#pragma unroll
for (int k = 0; k < 16; ++k) {{
    float* to = values.data[index.c[k]].c;
    Lanes& half = (k & 2) ? high : low;
    int at = (k & ~3) + 2 * (k & 1);
    *(Pair*)to = (Pair){{half[at], half[at + 1]}};
    to[2] = z[k];
}}
"""

_LOAD = f"""
{_TYPES}
const Stored* from = (const Stored*)values.data[first].c;
Lanes a = from[0], b = from[1], c = from[2];
Lanes x = __builtin_shufflevector(a, b, 0, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30, 0, 0, 0, 0, 0);
Lanes y = __builtin_shufflevector(a, b, 1, 4, 7, 10, 13, 16, 19, 22, 25, 28, 31, 0, 0, 0, 0, 0);
Lanes z = __builtin_shufflevector(a, b, 2, 5, 8, 11, 14, 17, 20, 23, 26, 29, 0, 0, 0, 0, 0, 0);
wp::vec_t<48, float> lanes;
Stored* to = (Stored*)lanes.c;
to[0] = __builtin_shufflevector(x, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 17, 20, 23, 26, 29);
to[1] = __builtin_shufflevector(y, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 18, 21, 24, 27, 30);
to[2] = __builtin_shufflevector(z, c, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 19, 22, 25, 28, 31);
return lanes;
"""

_STORE = f"""
{_TYPES}
Stored* to = (Stored*)values.data[first].c;
Lanes x = *(const Stored*)&lanes.c[0], y = *(const Stored*)&lanes.c[16], z = *(const Stored*)&lanes.c[32];
Lanes a = __builtin_shufflevector(x, y, 0, 16, 0, 1, 17, 1, 2, 18, 2, 3, 19, 3, 4, 20, 4, 5);
Lanes b = __builtin_shufflevector(x, y, 21, 5, 6, 22, 6, 7, 23, 7, 8, 24, 8, 9, 25, 9, 10, 26);
Lanes c = __builtin_shufflevector(x, y, 10, 11, 27, 11, 12, 28, 12, 13, 29, 13, 14, 30, 14, 15, 31, 15);
to[0] = __builtin_shufflevector(a, z, 0, 1, 16, 3, 4, 17, 6, 7, 18, 9, 10, 19, 12, 13, 20, 15);
to[1] = __builtin_shufflevector(b, z, 0, 21, 2, 3, 22, 5, 6, 23, 8, 9, 24, 11, 12, 25, 14, 15);
to[2] = __builtin_shufflevector(c, z, 26, 1, 2, 27, 4, 5, 28, 7, 8, 29, 10, 11, 30, 13, 14, 31);
"""

_LOAD_SCALARS = """
__builtin_memcpy(lanes.c, values.data + first, sizeof(lanes.c));
return lanes;
"""


@wp.func_native(_GATHER)
def gather(values: wp.array(dtype=wp.vec3), index: packed_int) -> packed_vector:
    """The rows of ``values`` that ``index`` names, in the lanes."""


@wp.func_native(_SCATTER)
def scatter(values: wp.array(dtype=wp.vec3), index: packed_int, lanes: packed_vector):
    """Store the lanes in the rows of ``values`` that ``index`` names."""


@wp.func_native(_LOAD)
def load(values: wp.array(dtype=wp.vec3), first: int) -> packed_vector:
    """Sixteen successive rows of ``values`` in the lanes."""


@wp.func_native(_STORE)
def store(values: wp.array(dtype=wp.vec3), first: int, lanes: packed_vector):
    """Store the lanes in sixteen successive rows of ``values``."""


@wp.func_native("wp::vec_t<16, float> lanes;" + _LOAD_SCALARS)
def load_scalars(values: wp.array(dtype=float), first: int) -> packed_float:
    """Sixteen successive numbers in the lanes."""


@wp.func_native("wp::vec_t<16, int> lanes;" + _LOAD_SCALARS)
def load_integers(values: wp.array(dtype=int), first: int) -> packed_int:
    """:func:`load_scalars` of integers."""
