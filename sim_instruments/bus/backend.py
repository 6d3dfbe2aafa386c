"""PyVISA backend ``@bench``: pyvisa-sim's library with live instruments in it.

``ResourceManager("<world id>@bench")`` opens the live world registered under that id. Any other name, for example
``path/to/file.yaml@bench``, is pyvisa-sim's business and behaves exactly as under ``@sim``.
"""

from __future__ import annotations

from collections import Counter
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

from pyvisa import constants, errors
from pyvisa.constants import AccessModes, Lock, ResourceAttribute, StatusCode
from pyvisa_sim.devices import Devices
from pyvisa_sim.highlevel import SimVisaLibrary
from pyvisa_sim.sessions.session import Session

from bench.model.clock import NS
from sim_instruments.bus.live import LiveDevice
from sim_instruments.worlds.common.world import live_world

_DEFAULT_TIMEOUT_MS = 2000
_LINE_FEED = 10


@dataclass
class _Holders:
    exclusive: int | None = None
    key: str = ""
    counts: Counter[int] = field(default_factory=Counter)


class _ResourceLocks:
    """Locks of the instruments, by the handle of a VISA session: exclusive locks nest, shared ones go by key."""

    def __init__(self) -> None:
        self._holders: dict[int, _Holders] = {}

    def check(self, session: int, device: LiveDevice) -> None:
        """Raise VI_ERROR_RSRC_LOCKED if another session has locked the instrument."""
        if not self._holders:
            return
        holders = self._holders.get(id(device))
        if holders is None or session in holders.counts:
            return
        raise errors.VisaIOError(StatusCode.error_resource_locked)

    def acquire(self, session: int, device: LiveDevice, kind: Lock, key: str | None) -> bool:
        """Take a lock; return False while another session's lock is in the way."""
        holders = self._holders.setdefault(id(device), _Holders())
        others = [holder for holder in holders.counts if holder != session]
        if kind == Lock.exclusive:
            if others:
                return False
            holders.exclusive = session
        else:
            wanted = key or holders.key or device.role
            if holders.exclusive not in (None, session) or (others and wanted != holders.key):
                return False
            holders.key = wanted
        holders.counts[session] += 1
        return True

    def release(self, session: int, device: LiveDevice) -> bool:
        """Give one lock back; return False if the session holds none."""
        holders = self._holders.get(id(device))
        if holders is None or session not in holders.counts:
            return False
        holders.counts[session] -= 1
        if holders.counts[session] == 0:
            self._drop(session, id(device), holders)
        return True

    def key(self, device: LiveDevice) -> str:
        """Return the access key of a shared lock, empty for an exclusive one."""
        holders = self._holders.get(id(device))
        return holders.key if holders is not None and holders.exclusive is None else ""

    def forget(self, session: int) -> None:
        """Give back everything a closed session held."""
        for device_id, holders in list(self._holders.items()):
            if session in holders.counts:
                self._drop(session, device_id, holders)

    def _drop(self, session: int, device_id: int, holders: _Holders) -> None:
        del holders.counts[session]
        if holders.exclusive == session:
            holders.exclusive = None
        if not holders.counts:
            del self._holders[device_id]


class BenchVisaLibrary(SimVisaLibrary):
    """pyvisa-sim's library; sessions on live devices are served here, all others by pyvisa-sim."""

    def _init(self) -> None:
        self._world = live_world(str(self.library_path))
        self._live: dict[int, tuple[Session, LiveDevice]] = {}
        self._locks = _ResourceLocks()
        if self._world is None:
            super()._init()
            return
        self.sessions = {}
        self._last_handle = 0
        self.devices: Devices = self._world.devices

    def _register(self, obj: Any) -> Any:
        if self._world is None:
            return super()._register(obj)
        self._last_handle += 1  # pyvisa-sim draws handles at random; live worlds are the same each time
        self.sessions[self._last_handle] = obj
        return self._last_handle

    def open(
        self,
        session: Any,
        resource_name: str,
        access_mode: AccessModes = AccessModes.no_lock,
        open_timeout: Any = constants.VI_TMO_IMMEDIATE,
    ) -> tuple[Any, StatusCode]:
        """Open a session; raises VI_ERROR_RSRC_NFOUND if nothing is at that address, or the world was closed."""
        if self._world is None:
            return super().open(session, resource_name, access_mode, open_timeout)
        if live_world(self._world.id) is None:
            raise errors.VisaIOError(StatusCode.error_resource_not_found)
        try:
            handle, status = super().open(session, resource_name, access_mode, open_timeout)
        except ValueError as error:  # pyvisa-sim has no session of that class (GPIB0::INTFC ...)
            raise errors.VisaIOError(StatusCode.error_resource_not_found) from error
        if status < 0:
            raise errors.VisaIOError(status)
        opened = self.sessions[handle]
        self._live[handle] = (opened, opened.device)
        if access_mode == AccessModes.exclusive_lock:
            self.lock(handle, Lock.exclusive, int(open_timeout))
        return handle, status

    def close(self, session: Any) -> StatusCode:
        """Close a session; its locks are given back."""
        if self._live.pop(session, None) is not None:
            self._locks.forget(session)
        return super().close(session)

    def write(self, session: Any, data: bytes) -> tuple[int, StatusCode]:
        """Send bytes; END with the last one unless the session's send_end is off."""
        live = self._live.get(session)
        if live is None:
            return super().write(session, data)
        opened, device = live
        self._released(session, device)
        with self._bus(session, device):
            device.receive(bytes(data), bool(opened.attrs.get(ResourceAttribute.send_end_enabled, True)))
        return len(data), StatusCode.success

    def read(self, session: Any, count: int) -> tuple[bytes, StatusCode]:
        """Read up to ``count`` bytes of one reply; VI_ERROR_TMO once the timeout has passed on the world's clock."""
        live = self._live.get(session)
        if live is None:
            return super().read(session, count)
        opened, device = live
        self._locks.check(session, device)
        self._released(session, device)
        deadline_ns = self._deadline_ns(session)
        reply = device.next_reply()
        if reply is None:
            device.on_starved()
        if reply is None or reply.ready_ns > deadline_ns:
            self._time_out(deadline_ns)
        self._world.wait_until_ns(max(reply.ready_ns, self._world.clock.now_ns() + device.latency_ns))
        with self._world.lock:
            return self._deliver(opened, device, reply, count, deadline_ns)

    def _deliver(
        self, opened: Session, device: LiveDevice, reply: Any, count: int, deadline_ns: int
    ) -> tuple[bytes, StatusCode]:
        if opened.attrs.get(ResourceAttribute.termchar_enabled, False):
            termchar = opened.attrs.get(ResourceAttribute.termchar, _LINE_FEED)
            place = reply.payload.find(termchar)
            if 0 <= place < count:
                return device.take(reply, place + 1), StatusCode.success_termination_character_read
        chunk = device.take(reply, count)
        if reply.payload:
            return chunk, StatusCode.success_max_count_read
        if not reply.end:
            self._time_out(deadline_ns)
        return chunk, StatusCode.success

    def _time_out(self, deadline_ns: int) -> None:
        self._world.wait_until_ns(deadline_ns)
        raise errors.VisaIOError(StatusCode.error_timeout)

    def _bus(self, session: Any, device: LiveDevice) -> AbstractContextManager[None]:
        self._locks.check(session, device)
        return self._world.bus_operation(device.latency_ns)

    def _device(self, session: Any) -> LiveDevice:
        live = self._live.get(session)
        if live is None:
            raise errors.VisaIOError(StatusCode.error_nonsupported_operation)
        return live[1]

    def _answering(self, session: Any) -> LiveDevice:
        """Return the instrument of a session; one that hangs answers no poll and no clear: VI_ERROR_TMO."""
        device = self._device(session)
        if device.faults.hang:
            self._time_out(self._deadline_ns(session))
        self._released(session, device)
        return device

    def _released(self, session: Any, device: LiveDevice) -> None:
        """Wait until an instrument lets the bus go; VI_ERROR_TMO if that is too late."""
        until_ns = device.held_until_ns
        if until_ns > self._world.clock.now_ns():
            deadline_ns = self._deadline_ns(session)
            if until_ns > deadline_ns:
                self._time_out(deadline_ns)
            self._world.wait_until_ns(until_ns)

    def _deadline_ns(self, session: Any) -> int:
        timeout_ms = self._live[session][0].attrs.get(ResourceAttribute.timeout_value, _DEFAULT_TIMEOUT_MS)
        return int(self._world.clock.now_ns()) + int(timeout_ms) * (NS // 1000)

    def read_stb(self, session: Any) -> tuple[int, StatusCode]:
        """Return the status byte, by serial poll."""
        device = self._answering(session)
        with self._bus(session, device):
            return device.status_byte(), StatusCode.success

    def clear(self, session: Any) -> StatusCode:
        """Clear the selected device."""
        device = self._answering(session)
        with self._bus(session, device):
            device.clear()
        return StatusCode.success

    def assert_trigger(self, session: Any, protocol: constants.TriggerProtocol) -> StatusCode:
        """Trigger the device, as group execute trigger does."""
        del protocol
        device = self._device(session)
        with self._bus(session, device):
            device.trigger()
        return StatusCode.success

    def flush(self, session: Any, mask: constants.BufferOperation) -> StatusCode:
        """Do nothing: nothing is buffered on this side of the bus."""
        del mask
        self._device(session)
        return StatusCode.success

    def gpib_control_ren(self, session: Any, mode: constants.RENLineOperation) -> StatusCode:
        """Do nothing: live instruments are always in remote."""
        del mode
        self._device(session)
        return StatusCode.success

    def lock(
        self, session: Any, lock_type: Lock, timeout: int, requested_key: str | None = None
    ) -> tuple[str, StatusCode]:
        """Lock the instrument; VI_ERROR_RSRC_LOCKED (after the timeout) while another session holds it."""
        device = self._device(session)
        if not self._locks.acquire(session, device, lock_type, requested_key):
            self._world.wait_until_ns(self._world.clock.now_ns() + int(timeout) * (NS // 1000))
            if not self._locks.acquire(session, device, lock_type, requested_key):
                raise errors.VisaIOError(StatusCode.error_resource_locked)
        return self._locks.key(device), StatusCode.success

    def unlock(self, session: Any) -> StatusCode:
        """Give one lock back; VI_ERROR_SESN_NLOCKED if the session holds none."""
        if not self._locks.release(session, self._device(session)):
            raise errors.VisaIOError(StatusCode.error_session_not_locked)
        return StatusCode.success
