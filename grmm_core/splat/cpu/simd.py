"""Eight or sixteen float32 lanes, or half as many float64 lanes, as one value inside kernels.

Numba's own vectoriser does not find the blocks of pixels that the tile kernels work on, so `Lanes` gives them to the compiler
explicitly: one LLVM vector, which becomes one AVX or AVX-512 register, several SSE or NEON registers, whatever the processor
has. There are sixteen lanes where the processor has registers for them, else eight. In a kernel,
+ - * / work lane by lane (multiply-adds are fused by the compiler), and the functions below do the rest.
Used by `blocks.py`, `forward.py`, `backward.py` and `projection.py`.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any

import numba
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba.core import cgutils, types
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import intrinsic as _intrinsic
from numba.extending import models, register_model

config: Any = numba.config  # the settings are put there at run time
intrinsic: Any = _intrinsic  # what it makes is called from kernels without the first argument


def _lanes() -> int:
    """Return the number of lanes that suits this processor, as numba compiles for it."""
    if config.CPU_NAME or config.CPU_FEATURES:  # the user has numba compile for another one
        return 8
    try:
        return 16 if get_host_cpu_features().get("avx512vl") else 8
    except RuntimeError:  # not known for this processor
        return 8


WIDTH = _lanes()
DOUBLES = WIDTH // 2  # float64 lanes
_VECTOR = ir.VectorType(ir.FloatType(), WIDTH)
_INDEX = ir.IntType(32)


class LanesType(types.Type):
    """Numba's type of WIDTH float32 lanes or DOUBLES float64 lanes."""

    def __init__(self, element: types.Float, width: int) -> None:
        super().__init__(name=f"Lanes{width}x{element.bitwidth}")
        self.element = element
        self.vector = ir.VectorType(ir.FloatType() if element.bitwidth == 32 else ir.DoubleType(), width)


LANES = LanesType(types.float32, WIDTH)
WIDE = LanesType(types.float64, DOUBLES)


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, kind.vector)


def _register(symbol: Callable[..., Any], build: str) -> None:
    """Let Python's operator `symbol` on lanes build the LLVM instruction called `build`."""

    class Template(ConcreteTemplate):
        cases = (signature(LANES, LANES, LANES), signature(WIDE, WIDE, WIDE))

    infer_global(symbol)(Template)

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return getattr(builder, build)(*args)

    lower_builtin(symbol, LANES, LANES)(lower)
    lower_builtin(symbol, WIDE, WIDE)(lower)


for _symbol, _build in ((operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")):
    _register(_symbol, _build)


def _shuffle(builder: Any, left: Any, right: Any, order: list[int]) -> Any:
    return builder.shuffle_vector(left, right, ir.Constant(ir.VectorType(_INDEX, len(order)), order))


def _broadcast(builder: Any, scalar: Any, vector: Any = _VECTOR) -> Any:
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, _INDEX(0))
    return _shuffle(builder, single, single, [0] * vector.count)


@intrinsic
def spread(typing: Any, scalar: Any) -> Any:
    """The float32 `scalar` in all lanes."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _broadcast(builder, context.cast(builder, args[0], sig.args[0], types.float32))

    return LANES(scalar), generate


@intrinsic
def spread_wide(typing: Any, scalar: Any) -> Any:
    """The float64 `scalar` in all float64 lanes."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _broadcast(builder, context.cast(builder, args[0], sig.args[0], types.float64), WIDE.vector)

    return WIDE(scalar), generate


def _kind_of(array: Any) -> LanesType:
    return WIDE if array.dtype == types.float64 else LANES


def _pointer(context: Any, builder: Any, kind: Any, array: Any, index: Any, index_kind: Any) -> Any:
    data = context.make_array(kind)(context, builder, array).data
    place = builder.gep(data, [context.cast(builder, index, index_kind, types.intp)])
    return builder.bitcast(place, _kind_of(kind).vector.as_pointer())


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """Lanes from array[index] on of a contiguous one-dimensional float32 or float64 array."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.load(_pointer(context, builder, sig.args[0], args[0], args[1], sig.args[1]), align=4)

    return _kind_of(array)(array, index), generate


@intrinsic
def store(typing: Any, array: Any, index: Any, value: Any) -> Any:
    """Write lanes to a contiguous one-dimensional array of their type, from array[index] on."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        builder.store(args[2], _pointer(context, builder, sig.args[0], args[0], args[1], sig.args[1]), align=4)
        return context.get_dummy_value()

    return types.void(array, index, value), generate


@intrinsic
def choose(typing: Any, left: Any, right: Any, then: Any, otherwise: Any) -> Any:
    """In each lane `then` where left >= right, else `otherwise`."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">=", args[0], args[1]), args[2], args[3])

    return then(left, right, then, otherwise), generate


@intrinsic
def smaller(typing: Any, left: Any, right: Any) -> Any:
    """The smaller one in each lane; `right` where `left` is not a number."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered("<", args[0], args[1]), args[0], args[1])

    return left(left, right), generate


@intrinsic
def larger(typing: Any, left: Any, right: Any) -> Any:
    """The larger one in each lane; `right` where `left` is not a number."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.select(builder.fcmp_ordered(">", args[0], args[1]), args[0], args[1])

    return left(left, right), generate


@intrinsic
def root(typing: Any, value: Any) -> Any:
    """The square root of each lane."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = sig.args[0].vector
        bits = sig.args[0].element.bitwidth
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector]), f"llvm.sqrt.v{vector.count}f{bits}"
        )
        return builder.call(function, args)

    return value(value), generate


@intrinsic
def append_at_least(typing: Any, array: Any, position: Any, base: Any, left: Any, right: Any) -> Any:
    """Write base + lane of every lane where left >= right to array[position:] (int32); return their number.

    Eight lanes at a time, by a table of where they go: AVX-512's own instruction that writes chosen lanes to memory takes over
    a hundred cycles on some processors, and others have none. Up to seven numbers after the last one are written, too.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(builder.fcmp_ordered(">=", args[3], args[4]), ir.IntType(WIDTH))
        eight, wide, byte = ir.VectorType(_INDEX, _CHOSEN), ir.IntType(64), ir.IntType(_CHOSEN)
        number = context.cast(builder, args[2], sig.args[2], types.int32)
        table = cgutils.global_constant(builder.module, "grmm_chosen_lanes", _chosen_lanes())
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        start = place = context.cast(builder, args[1], sig.args[1], types.int64)
        for first in range(0, WIDTH, _CHOSEN):
            mask = builder.trunc(builder.lshr(bits, ir.IntType(WIDTH)(first)), byte) if WIDTH > _CHOSEN else bits
            lanes = builder.load(builder.gep(table, [_INDEX(0), builder.zext(mask, wide)]), align=8)
            numbers = builder.add(builder.zext(lanes, eight), _broadcast(builder, builder.add(number, _INDEX(first)), eight))
            builder.store(numbers, builder.bitcast(builder.gep(data, [place]), eight.as_pointer()), align=4)
            place = builder.add(place, builder.zext(builder.ctpop(mask), wide))
        return builder.sub(place, start)

    return types.int64(array, position, base, left, right), generate


_CHOSEN = 8  # lanes that `append_at_least` handles at a time


def _chosen_lanes() -> Any:
    """For every set of eight lanes, those in it by number, first ones first, [256] vectors of eight bytes."""
    row = ir.VectorType(ir.IntType(8), _CHOSEN)
    rows = []
    for mask in range(1 << _CHOSEN):
        lanes = [lane for lane in range(_CHOSEN) if mask >> lane & 1]
        rows.append(ir.Constant(row, lanes + [0] * (_CHOSEN - len(lanes))))
    return ir.Constant(ir.ArrayType(row, len(rows)), rows)


@intrinsic
def copy_four(typing: Any, source: Any, start: Any, target: Any, place: Any) -> Any:
    """Copy source[start : start + 4] to target[place : place + 4], one-dimensional float32 arrays."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        four = ir.VectorType(ir.FloatType(), 4)
        places = []
        for number in (0, 2):
            data = context.make_array(sig.args[number])(context, builder, args[number]).data
            index = context.cast(builder, args[number + 1], sig.args[number + 1], types.intp)
            places.append(builder.bitcast(builder.gep(data, [index]), four.as_pointer()))
        builder.store(builder.load(places[0], align=4), places[1], align=4)
        return context.get_dummy_value()

    return types.void(source, start, target, place), generate


@intrinsic
def spread_four(typing: Any, array: Any, index: Any) -> Any:
    """array[index : index + 4] of a one-dimensional float32 array, again and again, in all lanes."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        four = ir.VectorType(ir.FloatType(), 4)
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        place = builder.gep(data, [context.cast(builder, args[1], sig.args[1], types.intp)])
        values = builder.load(builder.bitcast(place, four.as_pointer()), align=4)
        return _shuffle(builder, values, values, [lane % 4 for lane in range(WIDTH)])

    return LANES(array, index), generate


@intrinsic
def sum_fours(typing: Any, value: Any) -> Any:
    """In each lane the sum of the four lanes of its group of four."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        (total,) = args
        for step in (1, 2):
            total = builder.fadd(total, _shuffle(builder, total, total, [lane ^ step for lane in range(WIDTH)]))
        return total

    return LANES(value), generate


@intrinsic
def any_at_least(typing: Any, left: Any, right: Any) -> Any:
    """Whether left >= right in any lane."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        mask = builder.bitcast(builder.fcmp_ordered(">=", args[0], args[1]), ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", mask, ir.IntType(WIDTH)(0))

    return types.boolean(left, right), generate


def _fold(builder: Any, left: Any, right: Any, group: int) -> Any:
    """Add the halves of every `group` lanes: of `left` into the first halves of the result, of `right` into the second ones."""
    half = group // 2
    first, second = [], []
    for start in range(0, WIDTH, group):
        first += [*range(start, start + half), *range(WIDTH + start, WIDTH + start + half)]
        second += [*range(start + half, start + group), *range(WIDTH + start + half, WIDTH + start + group)]
    return builder.fadd(_shuffle(builder, left, right, first), _shuffle(builder, left, right, second))


@intrinsic
def store_totals(typing: Any, array: Any, index: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """Write the sums of the lanes of a, b, c and d to array[index : index + 4]."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pairs = _fold(builder, args[2], args[3], WIDTH), _fold(builder, args[4], args[5], WIDTH)
        sums = _fold(builder, *pairs, WIDTH // 2)  # a quarter of the lanes each, in the order a, c, b, d
        step = WIDTH // 8
        while step:
            sums = builder.fadd(sums, _shuffle(builder, sums, sums, [(lane + step) % WIDTH for lane in range(WIDTH)]))
            step //= 2
        quarter = WIDTH // 4
        four = _shuffle(builder, sums, sums, [0, 2 * quarter, quarter, 3 * quarter])
        data = context.make_array(sig.args[0])(context, builder, args[0]).data
        place = builder.gep(data, [context.cast(builder, args[1], sig.args[1], types.intp)])
        builder.store(four, builder.bitcast(place, four.type.as_pointer()), align=4)
        return context.get_dummy_value()

    return types.void(array, index, a, b, c, d), generate
