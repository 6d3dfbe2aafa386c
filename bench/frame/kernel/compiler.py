"""The kernel as machine code: numba and LLVM make an object file of every function; its parts are laid out to run.

The functions touch nothing but the memory whose addresses they are given, so their code needs no library at run time.
Format of the object files: System V ABI, ELF-64, with the relocations of x86-64.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

import llvmlite.binding as llvm
from numba import cfunc, types

from bench.frame.kernel.pack import encode
from bench.frame.kernel.quanta import count_quanta
from bench.frame.kernel.scan import decode
from bench.frame.kernel.variant import Variant

_TRIPLE = "x86_64-unknown-linux-gnu"
_ADDRESS = types.uint64
FUNCTIONS: dict[str, tuple[Callable[..., Any], Any]] = {
    "decode": (decode, types.void(_ADDRESS, _ADDRESS)),
    "encode": (encode, types.void(_ADDRESS, _ADDRESS, _ADDRESS, _ADDRESS)),
    "count_quanta": (count_quanta, types.void(_ADDRESS)),
}
_FROM_C = re.compile(r"^define [^\n]*@cfunc\..*?^}\n", re.MULTILINE | re.DOTALL)
_ALLOCATED, _NO_BITS, _RELOCATIONS = 2, 8, 4
_RELATIVE = (2, 4)  # R_X86_64_PC32, R_X86_64_PLT32
_LEFT_OUT = (b".eh_frame",)


class _Section(NamedTuple):
    name: int
    kind: int
    flags: int
    address: int
    at: int
    size: int
    link: int
    about: int
    align: int
    entry: int


def compiled(name: str, variant: Variant) -> tuple[bytes, int]:
    """Return the machine code of a function of ``FUNCTIONS``, for any address, and where it is entered.

    It is entered as numba's functions call each other: two pointers, for a result and an error that it does not have,
    come before the arguments. The way from C to there is left out, because it asks for the Python interpreter.
    """
    function, signature = FUNCTIONS[name]
    built = cfunc(signature, nopython=True, error_model="numpy")(function)
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    name = built.native_name.removeprefix("cfunc.")
    module = llvm.parse_assembly(_FROM_C.sub("", built.inspect_llvm()))
    target = llvm.Target.from_triple(_TRIPLE)
    machine = target.create_target_machine(
        cpu=variant.processor, features=variant.features, opt=3, reloc="pic", codemodel="small"
    )
    module.triple, module.data_layout = _TRIPLE, str(machine.target_data)
    return image_of(machine.emit_object(module), name.encode())


def image_of(thing: bytes, entry: bytes) -> tuple[bytes, int]:
    """Return what an object file has in memory, its parts bound to each other, and where the function ``entry`` begins.

    Raises: ValueError if something is asked for that is not in it.
    """
    (start,) = struct.unpack_from("<Q", thing, 40)
    width, count = struct.unpack_from("<HH", thing, 58)
    sections = [_Section(*struct.unpack_from("<IIQQQQIIQQ", thing, start + width * index)) for index in range(count)]
    names = sections[struct.unpack_from("<H", thing, 62)[0]].at
    image, places = bytearray(), {}
    for index, section in enumerate(sections):
        if section.flags & _ALLOCATED and not _text(thing, names + section.name).startswith(_LEFT_OUT):
            image += bytes(-len(image) % max(section.align, 1))
            places[index] = len(image)
            image += bytes(section.size) if section.kind == _NO_BITS else thing[section.at : section.at + section.size]
    for section in sections:
        if section.kind == _RELOCATIONS and section.about in places:
            _bind(image, thing, section, sections, places)
    table = next(section for section in sections if section.kind == 2)
    for at in range(table.at, table.at + table.size, 24):
        name, _, _, section_of, value, _ = struct.unpack_from("<IBBHQQ", thing, at)
        if _text(thing, sections[table.link].at + name) == entry and section_of in places:
            return bytes(image), places[section_of] + value
    raise ValueError(f"the object file has no function {entry.decode()}")


def _bind(image: bytearray, thing: bytes, section: _Section, sections: list[_Section], places: dict[int, int]) -> None:
    """Fill in the distances between the parts."""
    symbols = sections[section.link]
    for at in range(section.at, section.at + section.size, 24):
        offset, what, added = struct.unpack_from("<QQq", thing, at)
        name, _, _, where, value, _ = struct.unpack_from("<IBBHQQ", thing, symbols.at + 24 * (what >> 32))
        if where not in places or what & 0xFFFFFFFF not in _RELATIVE:
            symbol = _text(thing, sections[symbols.link].at + name).decode()
            raise ValueError(f"the code asks for {symbol!r} by a relocation of type {what & 0xFFFFFFFF}")
        place = places[section.about] + offset
        struct.pack_into("<i", image, place, places[where] + value + added - place)


def _text(thing: bytes, at: int) -> bytes:
    return thing[at : thing.index(b"\0", at)]
