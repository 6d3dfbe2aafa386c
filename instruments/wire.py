"""One VISA resource: time limits, transcript, serial poll, and back into step after a question without answer.

After a time-out nothing that was asked before can be taken for the answer to a later question: the device is cleared,
or (on a transport whose clear does not reach the instrument) it is asked who it is until exactly that answer comes.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from functools import partial
from typing import Any, Generic, TypeVar, cast

import pyvisa
from pyvisa.constants import StatusCode
from pyvisa.resources import MessageBasedResource

from bench.model.clock import NS, Clock, to_ns
from bench.model.errors import BenchError
from bench.model.installed import foreign_fault
from bench.model.ports import Transcript
from instruments.transport import is_stream

LONGEST_CALL_S = 1.5
OPEN_S = 1.0  # how long an opening is waited for at a time; one that takes longer is waited for again
FORGET_S = 3.0  # whoever was not asked for so long may be back, and is given the whole ladder
RETURN_S = 0.3  # a call comes back that long after its time limit at the latest, or it hangs
MESSAGE_AVAILABLE = 1 << 4  # status byte, IEEE Std 488.2
SLICE_S = 0.5  # longest wait without a sign of life; a run may be silent for 1.5 s
_ECHO_S = 1.0
_UNASKED_S = 0.001  # the least that pyvisa-py waits on a socket
_QUIET_S = 0.25
_MOST_LATE_S = 10.0  # a reply that is not there by then never comes
_MOST_STALE = 16
_CLEARS = 2
_CHUNK_BYTES = 1 << 18  # of a block; each chunk is a call of its own
# PyVISA's remark on a reply without a line feed: what a reply is worth, the parser of the driver says
warnings.filterwarnings("ignore", "read string doesn't end with termination characters", UserWarning, r"instruments\.")
_UNSUPPORTED = (StatusCode.error_nonsupported_operation, StatusCode.error_nonimplemented_operation)

T = TypeVar("T")


class BusError(Exception):
    """Whatever a VISA library raises, and all that lies below it: one class, so that none of it is forgotten.

    ``began_ns``: when the call was made, on the bench clock; ``limit_s``: how long it might have taken, second.
    """

    def __init__(self, error: Exception, began_ns: int, limit_s: float) -> None:
        super().__init__(" ".join(str(error).split()) or type(error).__name__)
        code = getattr(error, "error_code", None)
        self.began_ns, self.limit_s = began_ns, limit_s
        self.timed_out = code == StatusCode.error_timeout or isinstance(error, TimeoutError)
        self.unsupported = isinstance(error, NotImplementedError) or code in _UNSUPPORTED


class NotReturnedError(Exception):
    """A call has not come back within its limit; it may still do something."""


class Aside(Generic[T]):
    """One call that may not return (an opening, a library written in C), on a thread of its own, begun at once.

    Whoever waits for it gives signs of life, waits no longer than the limit, and goes on without it. A call that never
    returns keeps its thread, and nothing else. ``what`` names it for the error.
    """

    def __init__(self, what: str, call: Callable[[], T]) -> None:
        self._what, self._call = what, call
        self._result: T | None = None
        self._error: BaseException | None = None
        self._waited_s = 0.0
        self._thread = threading.Thread(target=self._run, name=what, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._result = self._call()
        except BaseException as error:  # raised where it is waited for
            self._error = error

    @property
    def under_way(self) -> bool:
        """True until the call has returned or raised."""
        return self._thread.is_alive()

    def wait(self, limit_s: float, live: Callable[[], None]) -> T:
        """Return what the call gives; ``live`` is called each half second. May be called again.

        Raises: what the call raises; NotReturnedError after ``limit_s`` (second).
        """
        rest_s = limit_s
        while self.under_way and rest_s > 0.0:
            slice_s = min(SLICE_S, rest_s)
            self._thread.join(slice_s)
            rest_s -= slice_s
            self._waited_s += slice_s
            if self.under_way:
                live()
        if self.under_way:
            raise NotReturnedError(f"{self._what} has not returned for {self._waited_s:.1f} s")
        if self._error is not None:
            raise self._error
        return cast("T", self._result)


class _Mode(threading.local):
    """How a thread uses a session: a watcher in a hurry must not hurry, nor be held up by, the steps beside it."""

    cap_s = LONGEST_CALL_S
    hurried = False  # no time for a recovery
    patient = False  # the address is opened again however long nobody has been there


class Wire:
    """A resource whose terminators are line feeds; every text goes to the transcript with the clock's time.

    ``echo`` is the identity question with its known reply, once there is one. ``in_step`` is False while a reply to an
    earlier question may still come. ``alive`` is what the last serial poll said, None when there is none on this bus.
    ``stream``: nothing but bytes reaches the instrument.
    ``reply_end``: the last character of a reply; what comes behind another than a line feed may be any bytes.
    ``spacing_s``: time between two commands, second, for an instrument that loses what comes sooner; half of it in a
    hurry, where what is lost is found by read-back and done again without one.
    ``where``: role and address.
    ``lost``: the code of the error after which nobody is there, "" while somebody is; only opening the address again
    helps.   ``heard_ns``: time of the last reply; ``silent_since_ns``: of the first question since then that got none.
    """

    def __init__(
        self, resource: MessageBasedResource, role: str, clock: Clock, transcript: Transcript,
        spacing_s: float = 0.0, reply_end: str = "\n",
    ) -> None:  # fmt: skip
        self._role, self._reply_end = role, reply_end
        self.where = f"{role} ({resource.resource_name})"
        self._spacing_ns = to_ns(spacing_s)
        self._spoke_ns = clock.now_ns()  # another session may have spoken just before this one was opened
        self._clock = clock
        self._transcript = transcript
        self._mode = _Mode()
        self.heard_ns = clock.now_ns()
        self.silent_since_ns: int | None = None
        self._missed_ns = 0
        self._opening: Aside[Any] | None = None
        self.echo: tuple[str, str] | None = None
        self._owed_ns: list[int] = []  # when each echo was asked for that has not come
        self._listening = False  # one has come, others have not
        self.adopt(resource)
        self.in_step = True

    def adopt(self, resource: MessageBasedResource) -> None:
        """Go on with a newly opened resource of the same address; only a new connection is in step from the start."""
        name = resource.resource_name.upper()
        self._resource = resource
        self._timeout_s = 0.0
        self.stream = is_stream(name)
        self._clears = not self.stream
        self.alive: bool | None = True
        self.lost = ""
        self._calling: Aside[Any] | None = None
        self.in_step = name.endswith("::SOCKET")
        if self.in_step and self.echo is not None:
            self._owe_nothing()
        resource.write_termination = "\n"
        resource.read_termination = self._reply_end
        if self._reply_end != "\n":
            resource.encoding = "latin-1"

    def release(self, wait_s: float = 0.0) -> None:
        """Close the resource, before it is opened again or for good; one that is gone is waited for ``wait_s``."""
        self.note("tx", "<close>")
        if self._clock.virtual:
            _closed(self._resource)
        else:
            with suppress(NotReturnedError):
                Aside("closing", partial(_closed, self._resource)).wait(wait_s, lambda: None)

    def open_again(self, opener: Callable[[], MessageBasedResource]) -> None:
        """Go on with the address opened anew, or with what an earlier opening has brought. Raises: BusError."""
        self.note("tx", "<open>")
        if self._clock.virtual:
            self.adopt(self._foreign(opener, OPEN_S))
            return
        if self._opening is None:
            self._opening = Aside("opening", opener)
        opening = self._opening
        try:
            resource = self._foreign(lambda: opening.wait(OPEN_S, lambda: self.note("tx", "<opening>")), OPEN_S)
        finally:
            if not opening.under_way:
                self._opening = None
        self.adopt(resource)

    def hurry(self, limit_s: float) -> AbstractContextManager[None]:
        """No call waits longer than ``limit_s`` (second); what fails is told at once and recovered later."""
        return self._changed(cap_s=limit_s, hurried=True)

    def persistent(self) -> AbstractContextManager[None]:
        """Let the address be opened again however long nobody has been there, and what is lost hold nothing up."""
        return self._changed(patient=True)

    @contextmanager
    def _changed(self, **mode: float) -> Iterator[None]:
        before = {name: getattr(self._mode, name) for name in mode}
        vars(self._mode).update(mode)
        try:
            yield
        finally:
            vars(self._mode).update(before)

    @property
    def hurried(self) -> bool:
        """Whether this thread has no time for a recovery."""
        return self._mode.hurried

    @property
    def patient(self) -> bool:
        """Whether this thread opens the address again however long nobody has been there."""
        return self._mode.patient

    def note(self, direction: str, text: str) -> None:
        """One line of the transcript: "tx" what the bench does, "rx" what it sees; a sign of life besides."""
        self._transcript(self._role, direction, text, self._clock.now_ns())

    def pause(self, seconds: float) -> None:
        """Wait on the bench clock, with a line in the transcript each half second."""
        end_ns = self._clock.now_ns() + to_ns(seconds)
        while (now_ns := self._clock.now_ns()) < end_ns:
            self.note("tx", "<pause>")
            self._clock.sleep_until_ns(min(end_ns, now_ns + to_ns(SLICE_S)))

    def poll_status(self, timeout_s: float = _ECHO_S) -> int:
        """Return status byte by serial poll. Raises: BusError."""
        status = int(self.call(timeout_s, self._resource.read_stb))
        self.note("rx", f"<status byte {status}>")
        return status

    def look_for_life(self) -> str:
        """Serial poll after a time-out: is anybody there, and is there a reply; what it says, for the error."""
        if self.alive is None:
            return ""
        self.note("tx", "<serial poll>")  # a sign of life: the call before took its whole time, so may this one
        try:
            status = self.poll_status()
        except BusError as error:
            self.alive = None if error.unsupported else False
            self.note("rx", f"<serial poll failed: {error}>")
            return "" if self.alive is None else ", nor to a serial poll"
        self.alive = True
        return f" (serial poll: {status})"

    def clear(self) -> None:
        """Get back into step: by device clear, or by asking who is there until that is answered."""
        self.in_step = self._device_cleared() or (not self.hurried and self._echoed())

    def came_unasked(self) -> bool:
        """Return whether something stands on a stream before a question: a reply that came twice is no answer to it.

        Elsewhere the protocol of messages throws it away; a bench inside this process has no such streams. What is owed
        is told from the answer when it comes.
        """
        listens = self.stream and not self._clock.virtual and not self._owed_ns
        return listens and self._begins(_UNASKED_S)

    def owe(self, question: str) -> None:
        """Note a question without an answer in time, if its late reply may be mistaken for an echo."""
        if self.echo is None or question == self.echo[0]:
            self._owed_ns.append(self._clock.now_ns())

    def came_late(self, question: str, reply: str) -> bool:
        """Return whether a reply is owed to an earlier question who is there, and not the answer to this one.

        At a first contact nobody can be told by an echo, and an instrument that boots, or a gateway, answers late.
        """
        late = self._owed_ns and self.echo is not None and question != self.echo[0] and reply.strip() == self.echo[1]
        if late:
            del self._owed_ns[0]
            self.note("rx", f"<not used: {reply}>")
        return bool(late)

    def hear(self, limit_s: float) -> str | None:
        """Return the next reply, to whatever question; None if none comes in ``limit_s`` (second) or the bus fails."""
        try:
            return str(self.call(limit_s, self._resource.read))
        except UnicodeDecodeError as error:
            return repr(error.object)
        except BusError:
            return None

    def collect(self, came: bytearray, timeout_s: float) -> None:
        """Append one reply to ``came``, whatever its bytes are, up to its END, or to a BusError."""
        resource = self._resource

        def read() -> None:
            status = StatusCode.success_max_count_read
            resource.read_termination = None  # a line feed is a byte like any other
            try:
                with resource.ignore_warning(resource.session, StatusCode.success_max_count_read):
                    while status == StatusCode.success_max_count_read:
                        chunk, status = resource.visalib.read(resource.session, _CHUNK_BYTES)
                        came.extend(chunk)
            finally:
                resource.read_termination = self._reply_end

        self.call(timeout_s, read)

    def call(self, timeout_s: float, operation: Callable[[], T]) -> T:
        """Do one call of the VISA library within a time limit, second, and no longer than that.

        Raises: BusError, UnicodeDecodeError.
        """
        resource, limit_s = self._resource, min(timeout_s, self._mode.cap_s)

        def limited() -> T:
            if limit_s != self._timeout_s:
                resource.timeout = round(1000 * limit_s)
                if resource is self._resource:  # it may come back late, when another one has been opened
                    self._timeout_s = limit_s
            return operation()

        if self._clock.virtual:
            return self._foreign(limited, limit_s)
        if self._calling is not None and self._calling.under_way:  # two calls on one session would mix their bytes
            error = NotReturnedError("an earlier call of the VISA library has not returned")
            raise BusError(error, self._clock.now_ns(), limit_s)
        calling = self._calling = Aside("the VISA library", limited)
        return self._foreign(lambda: calling.wait(limit_s + RETURN_S, lambda: self.note("tx", "<waiting>")), limit_s)

    def _foreign(self, call: Callable[[], T], limit_s: float) -> T:
        """Return what a call gives; what others raise becomes a BusError, what the bench raises itself stays."""
        began_ns = self._clock.now_ns()
        try:
            return call()
        except (BenchError, UnicodeDecodeError):
            raise
        except Exception as error:
            # a bus fails with errors of VISA or of the system; others are mistakes in somebody's simulator
            fault = None if isinstance(error, pyvisa.Error | OSError) else foreign_fault(error)
            if fault is not None:
                raise fault from error
            raise BusError(error, began_ns, limit_s) from error

    def heard(self) -> None:
        """Note that a reply has come: somebody is there."""
        self.heard_ns, self.silent_since_ns, self.lost = self._clock.now_ns(), None, ""

    def missed(self, error: BusError, code: str) -> None:
        """Note that a call failed (``code``); a bus that fails, or an instrument mute to all, is lost."""
        self.tried(error.began_ns)
        if not error.timed_out or self.alive is False:
            self.lost = code

    def tried(self, began_ns: int) -> None:
        """Note a try without an answer; one that comes long after the last begins a trouble of its own."""
        if self.silent_since_ns is None or began_ns - self._missed_ns > to_ns(FORGET_S):
            self.silent_since_ns = began_ns
        self._missed_ns = self._clock.now_ns()

    def silence_s(self) -> float:
        """Return for how long nobody has answered, second; 0 if the last question was answered."""
        return 0.0 if self.silent_since_ns is None else (self._clock.now_ns() - self.silent_since_ns) / NS

    def _owe_nothing(self) -> None:
        self._owed_ns.clear()
        self._listening = False

    def _device_cleared(self) -> bool:
        if not self._clears:
            return False
        for _ in range(
            1 if self.hurried else _CLEARS
        ):  # the second one finds the acknowledgement that a late reply kept from the first
            self.note("tx", "<device clear>")
            try:
                self.call(_ECHO_S, self._resource.clear)
            except BusError as error:
                self.note("rx", f"<device clear failed: {error}>")
                self._clears = not error.unsupported
                if not self._clears:
                    return False
            else:
                self._owe_nothing()
                return True
        return False

    def _echoed(self) -> bool:
        """Replies come in the order of their questions: once each echo has come, nothing older can come.

        An echo that is missing may be lost or late. It is listened for, and not asked for again, until it must be lost.
        """
        if self.echo is None:
            return self._is_quiet(_ECHO_S)  # what comes later still is told by its text
        question, answer = self.echo
        if not self._listening:
            self.note("tx", question)
            try:
                self.call(_ECHO_S, partial(self._resource.write, question))
            except BusError as error:
                self.note("rx", f"<{question!r} failed: {error}>")
                return False
            self.owe(question)
        return self._heard_echoes(answer) and self._is_quiet(_QUIET_S)

    def _heard_echoes(self, answer: str) -> bool:
        for _ in range(_MOST_STALE):
            reply = self._unused(_ECHO_S)
            if reply is None:
                oldest_ns = self._clock.now_ns() - to_ns(_MOST_LATE_S)
                self._owed_ns = [asked_ns for asked_ns in self._owed_ns if asked_ns > oldest_ns]
                break
            if reply.strip() == answer:
                self._listening = True
                del self._owed_ns[:1]
                if not self._owed_ns:
                    break
        complete = self._listening and not self._owed_ns
        self._listening = self._listening and not complete
        return complete

    def _is_quiet(self, quiet_s: float) -> bool:
        return any(not self._begins(quiet_s) or self._unused(_ECHO_S) is None for _ in range(_MOST_STALE))

    def _begins(self, limit_s: float) -> bool:
        """Return whether a byte comes that nobody asked for: half a reply is one as well, and its rest no answer."""
        resource = self._resource

        def read() -> None:
            with resource.ignore_warning(resource.session, StatusCode.success_max_count_read):
                resource.visalib.read(resource.session, 1)

        with suppress(BusError):
            self.call(limit_s, read)
            self.note("rx", "<a reply that nobody asked for>")
            return True
        return False

    def _unused(self, limit_s: float) -> str | None:
        reply = self.hear(limit_s)
        if reply is not None:
            self.note("rx", f"<not used: {reply}>")
            if self.echo is None:
                del self._owed_ns[:1]
        return reply


def _closed(resource: MessageBasedResource) -> None:
    with suppress(Exception):  # one that is gone already is closed
        resource.close()
