"""Words of memory for the compiled kernel: loads and stores at addresses, reversed bytes and bits, carry-less products.

Addresses instead of arrays: numba counts references to arrays and checks indices for wrap-around. No load and no store
may leave the arrays whose addresses they are; the callers say how many bytes may be read.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

U64 = types.uint64
BYTE, ONE, EIGHT = np.uint64(255), np.uint64(1), np.uint64(8)
_LONG, _WORD, _BYTE, _FLOAT = ir.IntType(64), ir.IntType(32), ir.IntType(8), ir.DoubleType()
_PAIR = ir.VectorType(_LONG, 2)
inlined = njit(forceinline=True, error_model="numpy")
"""Compiles a function into those that call it; nothing in it can raise."""


def _typed(signature: Any, generate: Any) -> Any:
    return signature, generate


def _loading(width: int) -> Any:
    """Return the function that gives ``width`` bits of any address, the first byte lowest."""

    def load(typingctx: Any, address: Any) -> Any:
        return _typed(U64(U64), lambda context, builder, signature, args: _loaded(builder, args[0], width))

    return intrinsic(load)


load_8, load_16, load_32, load_64 = map(_loading, (8, 16, 32, 64))


@intrinsic
def swap_64(typingctx: Any, value: Any) -> Any:
    """The bytes of a word in reverse order."""
    return _typed(U64(U64), lambda context, builder, signature, args: builder.bswap(args[0]))


@intrinsic
def turn_64(typingctx: Any, value: Any) -> Any:
    """The bits of a word in reverse order."""
    return _typed(U64(U64), lambda context, builder, signature, args: builder.bitreverse(args[0]))


@intrinsic
def as_float(typingctx: Any, value: Any) -> Any:
    """The float whose bits a word holds."""
    return _typed(types.float64(U64), lambda context, builder, signature, args: builder.bitcast(args[0], _FLOAT))


@intrinsic
def as_word(typingctx: Any, value: Any) -> Any:
    """The bits of a float."""
    return _typed(U64(types.float64), lambda context, builder, signature, args: builder.bitcast(args[0], _LONG))


def _storing(width: int) -> Any:
    """Return the function that writes the lowest ``width`` bits of a value at any address."""

    def store(typingctx: Any, address: Any, value: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.IntType(width)
            cut = args[1] if width == 64 else builder.trunc(args[1], kind)
            builder.store(cut, _pointer(builder, args[0], kind), align=1)
            return context.get_dummy_value()

        return _typed(types.void(U64, U64), generate)

    return intrinsic(store)


store_8, store_16, store_32, store_64 = map(_storing, (8, 16, 32, 64))


def _swapping(width: int) -> Any:
    """Return the function that copies 16 bytes, those of every number of ``width`` bits in reverse order."""

    def swap_16(typingctx: Any, source: Any, target: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            kind = ir.VectorType(ir.IntType(width), 128 // width)
            loaded = builder.load(_pointer(builder, args[0], kind), align=1)
            name = f"llvm.bswap.v{128 // width}i{width}"
            swap = cgutils.get_or_insert_function(builder.module, ir.FunctionType(kind, [kind]), name)
            builder.store(builder.call(swap, [loaded]), _pointer(builder, args[1], kind), align=1)
            return context.get_dummy_value()

        return _typed(types.void(U64, U64), generate)

    return intrinsic(swap_16)


swap_pairs, swap_fours, swap_eights = map(_swapping, (16, 32, 64))


def _folding(swapped: bool) -> Any:
    """Return the function that divides words of memory by a polynomial; see bench.frame.kernel.checks.

    The sum is first * powers[count] + (word + carry) * powers[count - 1] + word * powers[count - 2] + ... + word, for
    ``count`` words, one at least. ``swapped``: the bytes of every word of memory in reverse order, its highest bit is
    the highest power; else it is the lowest bit. ``constants``: poly, inverse, power 128.
    """

    def fold(typingctx: Any, address: Any, count: Any, first: Any, carry: Any, powers: Any, constants: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            address, count, first, carry, powers, constants = args

            def power(index: Any) -> Any:
                return _loaded(builder, builder.add(powers, builder.shl(index, _LONG(3))), 64)

            def word(left: Any, added: Any) -> Any:
                at = builder.add(address, builder.shl(builder.sub(count, left), _LONG(3)))
                loaded = _loaded(builder, at, 64)
                return builder.xor(builder.bswap(loaded) if swapped else loaded, added)

            begin = _product(builder, _low(builder, first), _low(builder, power(count)))
            before = builder.block
            head, body, done = (builder.append_basic_block(name) for name in ("fold", "folded", "done"))
            builder.branch(head)
            builder.position_at_end(head)
            left, added, sum_ = builder.phi(_LONG), builder.phi(_LONG), builder.phi(_PAIR)
            builder.cbranch(builder.icmp_unsigned(">", left, _LONG(1)), body, done)
            builder.position_at_end(body)
            fewer = builder.sub(left, _LONG(1))
            part = _product(builder, _low(builder, word(left, added)), _low(builder, power(fewer)))
            total = builder.xor(sum_, part)
            builder.branch(head)
            for phi, at_first, later in ((left, count, fewer), (added, carry, _LONG(0)), (sum_, begin, total)):
                phi.add_incoming(at_first, before)
                phi.add_incoming(later, body)
            builder.position_at_end(done)
            last = _low(builder, word(left, added))
            divided = _divided_plain if swapped else _divided_reflected
            return divided(builder, sum_, last, *(_constant(builder, constants, index) for index in range(3)))

        return _typed(U64(U64, U64, U64, U64, U64, U64), generate)

    return intrinsic(fold)


fold_reflected, fold_plain = map(_folding, (False, True))


def _divided_plain(builder: Any, sum_: Any, last: Any, poly: Any, inverse: Any, power_128: Any) -> Any:
    """Return what a sum and a last word leave: high * x^128 + low * x^64 modulo the polynomial (Barrett)."""
    sum_ = builder.xor(sum_, last)
    both = builder.xor(_product(builder, sum_, power_128, 0x01), _shuffled(builder, sum_, (2, 0)))
    quotient = builder.xor(_product(builder, both, inverse, 0x01), both)
    rest = builder.xor(_product(builder, quotient, poly, 0x01), both)
    return builder.extract_element(rest, _WORD(0))


def _divided_reflected(builder: Any, sum_: Any, last: Any, poly: Any, inverse: Any, power_128: Any) -> Any:
    """Like ``_divided_plain`` for words in reversed order: the low one is the high one, and products lack one bit."""
    sum_ = builder.xor(sum_, _shuffled(builder, last, (2, 0)))
    both = builder.xor(_product(builder, sum_, power_128), _shuffled(builder, sum_, (1, 2)))
    one = ir.Constant(_PAIR, [1, 1])
    quotient = builder.xor(builder.shl(_product(builder, both, inverse), one), both)
    found = _product(builder, quotient, poly)
    carried = builder.lshr(_shuffled(builder, found, (2, 0)), ir.Constant(_PAIR, [63, 63]))
    rest = builder.xor(builder.xor(builder.shl(found, one), carried), both)
    return builder.extract_element(rest, _WORD(1))


def _low(builder: Any, word: Any) -> Any:
    return builder.insert_element(ir.Constant(_PAIR, [0, 0]), word, _WORD(0))


def _constant(builder: Any, constants: Any, index: int) -> Any:
    return _low(builder, _loaded(builder, builder.add(constants, _LONG(8 * index)), 64))


def _shuffled(builder: Any, pair: Any, order: tuple[int, int]) -> Any:
    """Return two words of a pair, the third being zero."""
    return builder.shuffle_vector(pair, ir.Constant(_PAIR, [0, 0]), ir.Constant(ir.VectorType(_WORD, 2), list(order)))


def _product(builder: Any, one: Any, other: Any, chosen: int = 0) -> Any:
    """Return the carry-less product of two words: both low ones, or of ``one`` the high one if ``chosen`` is 1."""
    kind = ir.FunctionType(_PAIR, [_PAIR, _PAIR, _BYTE])
    function = cgutils.get_or_insert_function(builder.module, kind, "llvm.x86.pclmulqdq")
    return builder.call(function, [one, other, _BYTE(chosen)])


def _pointer(builder: Any, address: Any, kind: Any) -> Any:
    return builder.inttoptr(address, kind.as_pointer())


def _loaded(builder: Any, address: Any, bits: int) -> Any:
    value = builder.load(_pointer(builder, address, ir.IntType(bits)), align=1)
    return value if bits == 64 else builder.zext(value, ir.IntType(64))


@inlined
def told(numbers, index):
    """Return a number of the definition, or of a row of it that begins at ``numbers``."""
    return np.int64(load_64(numbers + np.uint64(8 * index)))


@inlined
def tell(numbers, index, value):
    """Write a number of a task."""
    store_64(numbers + np.uint64(8 * index), np.uint64(value))


@inlined
def row_of(numbers, first, index, columns):
    """Return the address of a row of a table that begins at the number ``first`` of the definition."""
    return numbers + np.uint64(8 * (told(numbers, first) + index * columns))


@inlined
def raised_at(address, there, size, big):
    """Return a number of up to eight bytes in the highest bits of a word; ``there``: bytes that may be read."""
    if there >= 8:
        word = load_64(address)
        return swap_64(word) if big else word << np.uint64(64 - 8 * size)
    value = np.uint64(0)
    for index in range(size):
        value = value << EIGHT | load_8(address + np.uint64(index if big else size - 1 - index))
    return value << np.uint64(64 - 8 * size)


@inlined
def number_at(address, there, size, big):
    """Return an unsigned number of up to eight bytes."""
    return raised_at(address, there, size, big) >> np.uint64(64 - 8 * size)


@inlined
def number_before(address, back, size, big):
    """Return an unsigned number that ends in front of an address; ``back``: bytes before it that may be read."""
    if back < 8:
        return number_at(address - np.uint64(size), size, size, big)
    word, shift = load_64(address - EIGHT), np.uint64(64 - 8 * size)
    return (swap_64(word) << shift) >> shift if big else word >> shift
