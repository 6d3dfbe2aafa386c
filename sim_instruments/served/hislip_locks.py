"""HiSLIP locks of one instrument: one exclusive, or shared ones under one key; a client's locks end with its session.

Source: IVI-6.1, 6.5 (lock transaction) and 2.6.1 (traffic of a client without the lock waits, it is not refused).
"""

from __future__ import annotations

import threading
from enum import IntEnum


class LockAnswer(IntEnum):
    """Control code of an AsyncLockResponse."""

    FAILURE = 0
    EXCLUSIVE = 1
    SHARED = 2
    ERROR = 3


class HislipLocks:
    """Who holds the instrument; clients are named by any hashable object. Safe to use from all sessions' threads."""

    def __init__(self) -> None:
        self._guard = threading.Lock()
        self._exclusive: object | None = None
        self._key = ""
        self._sharing: set[object] = set()

    def request(self, client: object, key: str) -> LockAnswer:
        """Ask for the exclusive lock (empty key) or a shared one; FAILURE while another client is in the way."""
        with self._guard:
            if client in (self._sharing if key else {self._exclusive}):
                return LockAnswer.ERROR
            others = self._sharing - {client}
            if self._exclusive not in (None, client) or (others and not self._fits(client, key)):
                return LockAnswer.FAILURE
            if not key:
                self._exclusive = client
                return LockAnswer.EXCLUSIVE
            self._key = key
            self._sharing.add(client)
            return LockAnswer.SHARED

    def _fits(self, client: object, key: str) -> bool:
        """Beside shared locks of others: the same key, or alone for one of those who share."""
        return key == self._key if key else client in self._sharing

    def release(self, client: object) -> LockAnswer:
        """Give one lock back, the exclusive one first; ERROR if the client holds none."""
        with self._guard:
            if self._exclusive is client:
                self._exclusive = None
                return LockAnswer.EXCLUSIVE
            if client in self._sharing:
                self._sharing.discard(client)
                return LockAnswer.SHARED
            return LockAnswer.ERROR

    def forget(self, client: object) -> None:
        """Give back everything a client held."""
        with self._guard:
            if self._exclusive is client:
                self._exclusive = None
            self._sharing.discard(client)

    def shut_out(self, client: object) -> bool:
        """Return whether a lock of others keeps this client's commands waiting."""
        with self._guard:
            if self._exclusive is not None:
                return self._exclusive is not client
            return bool(self._sharing) and client not in self._sharing

    def holders(self) -> tuple[bool, int]:
        """Return whether the exclusive lock is held, and by how many clients any lock is."""
        with self._guard:
            alone = {self._exclusive} - {None}
            return self._exclusive is not None, len(self._sharing | alone)
