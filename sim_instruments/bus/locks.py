"""VISA locks of live instruments: exclusive ones nest, shared ones are shared by key."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from pyvisa.constants import Lock, StatusCode
from pyvisa.errors import VisaIOError

from sim_instruments.bus.live import LiveDevice


@dataclass
class _Holders:
    exclusive: int | None = None
    key: str = ""
    counts: Counter[int] = field(default_factory=Counter)


class ResourceLocks:
    """Who holds which instrument; a holder is the handle of a VISA session."""

    def __init__(self) -> None:
        self._holders: dict[int, _Holders] = {}

    def check(self, session: int, device: LiveDevice) -> None:
        """Raise VI_ERROR_RSRC_LOCKED if another session has locked the instrument."""
        if not self._holders:
            return
        holders = self._holders.get(id(device))
        if holders is None or session in holders.counts:
            return
        raise VisaIOError(StatusCode.error_resource_locked)

    def acquire(self, session: int, device: LiveDevice, kind: Lock, key: str | None) -> bool:
        """Take a lock; False while another session's lock is in the way."""
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
        """Give one lock back; False if the session holds none."""
        holders = self._holders.get(id(device))
        if holders is None or session not in holders.counts:
            return False
        holders.counts[session] -= 1
        if holders.counts[session] == 0:
            self._drop(session, id(device), holders)
        return True

    def key(self, device: LiveDevice) -> str:
        """Access key of a shared lock, empty for an exclusive one."""
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
