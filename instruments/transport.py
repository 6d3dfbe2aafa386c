"""What an address gives besides messages, through the VISA library that is installed: so that `bench check` can refuse
one over which a driver cannot work, before anything is opened.

It is read off the classes of the library: whoever implements a call overrides that of a base class, which refuses it.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from importlib import import_module, util
from pathlib import Path
from typing import Any, Literal

from pyvisa.constants import InterfaceType
from pyvisa.highlevel import VisaLibraryBase, get_wrapper_class
from pyvisa.rname import ResourceName

Need = Literal["serial poll", "device clear", "service request", "lock", "END"]
_CALLS: dict[Need, str] = {
    "serial poll": "read_stb", "device clear": "clear", "service request": "wait_on_event", "lock": "lock",
}  # fmt: skip


def is_stream(address: str) -> bool:
    """Return whether a VISA address leads to a stream of bytes, where nothing but bytes reaches the instrument.

    What a library calls "clear" there empties its own buffers. Source: VPP-4.3, resources ASRL INSTR and TCPIP SOCKET.
    """
    return re.fullmatch(r"ASRL.*|.*::(SOCKET|RAW)", address.upper()) is not None


def lacking(needs: Collection[Need], library: str, address: str) -> list[Need]:
    """Return what is needed and not given by an address through a library such as "@py", or "adapters".

    Nothing is lacking where the library is not there.
    """
    try:
        return [need for need in needs if is_stream(address) or not _implements(library, address, need)]
    except (KeyError, ValueError):  # no such library, or no such kind in it, which is told where it is opened
        return []


def _implements(library: str, address: str, need: Need) -> bool:
    if library == "adapters":  # bench.run.bus.prologix; the end of a reply is a line feed there
        return need in ("serial poll", "device clear")
    if need == "END":
        return True
    call, wrapper = _CALLS[need], get_wrapper_class(library.removeprefix("@"))
    if getattr(wrapper, call) is getattr(VisaLibraryBase, call):
        return False
    return library != "@py" or _session_implements(address, call)


def _session_implements(address: str, call: str) -> bool:
    """Return whether pyvisa-py's session of an address has a call of its own.

    One that lacks its own library (PyUSB, linux-gpib) has no class, and the source that would make it is asked.
    """
    from pyvisa_py.sessions import Session, UnavailableSession

    kind = _session_class(address)
    if not issubclass(kind, UnavailableSession):
        return getattr(kind, call) is not getattr(Session, call)
    source = util.find_spec(f"pyvisa_py.{re.split('[^a-z]', address.lower())[0]}")
    return source is None or f"def {call}(" in Path(str(source.origin)).read_text(encoding="utf-8")


def _session_class(address: str) -> type[Any]:
    from pyvisa_py.sessions import Session

    import_module("pyvisa_py.highlevel")  # registers the kinds that it can serve
    name = ResourceName.from_string(address)
    kind: type[Any] = Session.get_session_class(InterfaceType[name.interface_type.lower()], name.resource_class)
    by_hislip = str(getattr(name, "lan_device_name", "")).lower().startswith("hislip")
    behind = {  # classes that only make another one
        "TCPIPInstrSession": "TCPIPInstrHiSLIP" if by_hislip else "TCPIPInstrVxi11",
        "GPIBSessionDispatch": "GPIBSession",
    }.get(kind.__name__)
    made: type[Any] = kind if behind is None else kind.__new__.__globals__[behind]  # type: ignore[attr-defined]
    return made
