"""The world of the GNC bench: test board, modules by serial number, the table they lie on, Earth.

The simulated test board with a GNC module in its socket: one RS-422 port, commands, answers, streams.

Everything happens at a time of its own, in order: bytes of a command arrive at the speed of the line, a command takes
as long as it takes, samples are due on the module's clock. Whoever looks at the port, or changes anything, first lets
happen what was due until then.
"""

from __future__ import annotations

import heapq
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bench.frame import load_frame
from bench.model.arrays import Integers
from bench.model.clock import NS, Clock, to_ns
from bench.model.lab import find_shipped
from bench.model.ports import RecordWindow
from sim_instruments.faults.switchboard import LinkFaults
from sim_instruments.worlds.common.attitude import Site
from sim_instruments.worlds.common.motion import AxisMotion
from sim_instruments.worlds.common.port import BITS_PER_BYTE, OnePortUnit
from sim_instruments.worlds.common.thermal import Thermal
from sim_instruments.worlds.common.world import Operation, World
from sim_instruments.worlds.gnc.commands import HANDLERS, BadParameterError, Job, Status
from sim_instruments.worlds.gnc.imu import GncImu
from sim_instruments.worlds.gnc.imu_errors import ImuOptions
from sim_instruments.worlds.gnc.link import BOARD, SILENCE_NS, US, BoardReceiver, Request, Stream
from sim_instruments.worlds.gnc.magnetometer import Correction
from sim_instruments.worlds.gnc.module import GncModule
from sim_instruments.worlds.gnc.options import parse_faults
from sim_instruments.worlds.gnc.truth import estimates

PORT = "rs422"
BOOT_S = 1.2  # from power to the first command
STREAM_S = 0.005  # from the answer of stream_start to the first sample
START_V = 4.4  # the processor does not run below
KEPT_ANSWERS = 8


class GncBoard(OnePortUnit):
    """The unit under test of the world ``gnc_module``.

    Args:
        clock: of the bench.   module: the module in the socket at the beginning.
        dip_switch: gives the DIP switch that is on, 0 for none.
    """

    port_name = PORT

    def __init__(self, clock: Clock, module: GncModule, dip_switch: Callable[[], int]) -> None:
        super().__init__(clock)
        self.definition = load_frame(find_shipped("frames", "gnc_422"))
        self.module, self.dip_switch = module, dip_switch
        self.correction = Correction()
        self.stream: Stream | None = None
        self._baud, self._link = 921_600, LinkFaults()
        self._heard = LinkFaults()
        self._frames_heard = 0
        self._line_free_ns = 0
        self._events: list[tuple[int, int, Callable[[int], None]]] = []
        self._order = 0
        self._supply_V = 0.0
        self._booted_ns: int | None = None  # None: the processor does not run
        self._counted = self._sent = 0
        self._forget()

    def _forget(self) -> None:
        """Forget what the processor loses without power."""
        self._receiver = BoardReceiver(self.definition)
        self._answers: OrderedDict[tuple[int, int, int, bytes], bytes] = OrderedDict()
        self._busy = False
        self._end_stream()
        self._counted = 0
        self.correction = Correction()

    # --- the bench ---------------------------------------------------------------------------------------------

    @property
    def board_V(self) -> float:
        """Voltage at the 5 V test point of the board."""
        return self.module.power.board_V(self._supply_V) if self._supply_V else 0.0

    def set_power(self, on: bool, t_ns: int, voltage_V: float) -> None:
        """Supply on or off; switched on, the module boots before it listens."""
        with self.lock:
            self._upto(max(t_ns, self._clock.now_ns()))
            self._supply_V = voltage_V if on else 0.0
            self._power_changed(t_ns)

    def insert(self, module: GncModule) -> None:
        """Another module comes into the socket; with the supply on it starts at once."""
        with self.lock:
            now_ns = self._upto(self._clock.now_ns())
            supply_V, self._supply_V = self._supply_V, 0.0
            self._power_changed(now_ns)
            self.module, self._supply_V = module, supply_V
            self._power_changed(now_ns)

    def settle(self) -> None:
        """Let everything happen that is due by now; to be called before anything the module sees is changed."""
        with self.lock:
            self._upto(self._clock.now_ns())

    def _power_changed(self, t_ns: int) -> None:
        runs = self.board_V >= START_V
        if runs == (self._booted_ns is not None):
            return
        self._forget()
        self.module.set_power(runs, t_ns)
        self._booted_ns = t_ns if runs else None

    # --- the port ----------------------------------------------------------------------------------------------

    def connect(self, name: str, baud: int, faults: LinkFaults | None = None) -> None:
        """Listen to the port from now on; ``faults`` damages both directions from now on."""
        del name
        with self.lock:
            self._upto(self._clock.now_ns())
            self._baud, self._link = baud, faults or LinkFaults()
            self._heard = LinkFaults(self._link.seed, f"{self._link.name} to the unit")
            self.port.connect(baud, faults)

    def write(self, name: str, sent: bytes) -> None:
        """Send bytes to the board; they arrive as fast as the line carries them."""
        del name
        with self.lock:
            now_ns = self._upto_now()
            begin_ns = max(now_ns, self._line_free_ns)
            self._line_free_ns = end_ns = begin_ns + BITS_PER_BYTE * NS * len(sent) // self._baud
            if arriving := self._damaged(sent):
                self._at(end_ns, lambda t_ns: self._hear(arriving, begin_ns, t_ns))

    def _damaged(self, sent: bytes) -> bytes:
        """Return what arrives of it: the link damages both directions alike."""
        if not sent or not self._link.active:
            return sent
        for switch in ("bit_error_rate", "drop_rate", "duplicate_rate", "silent", "unplugged"):
            setattr(self._heard, switch, getattr(self._link, switch))
        rows = np.frombuffer(sent, np.uint8).reshape(1, -1)
        number = self._frames_heard
        self._frames_heard += 1
        return self._heard.frames(number, rows).tobytes() * int(self._heard.copies(number, 1)[0])

    def _foreseen(self, name: str, t_ns: Integers) -> Integers:
        """Send the samples due by the coming times, up to what the board does next by itself."""
        self._upto_now()
        known = t_ns[t_ns < self._events[0][0]] if self._events else t_ns
        if len(known):
            self._send_samples(int(known[-1]))
        return known

    # --- time --------------------------------------------------------------------------------------------------

    def _upto(self, now_ns: int) -> int:
        """Let happen what is due; returns the time."""
        while self._events and self._events[0][0] <= now_ns:
            t_ns, _, event = heapq.heappop(self._events)
            self._send_samples(t_ns)
            event(t_ns)
        self._send_samples(now_ns)
        return now_ns

    def _at(self, t_ns: int, event: Callable[[int], None]) -> None:
        self._order += 1
        heapq.heappush(self._events, (t_ns, self._order, event))

    def _send_samples(self, t_ns: int) -> None:
        if self.stream is not None:
            self.stream.send(t_ns, self.port, self.definition)
            if self.stream.over:
                self._end_stream()

    # --- commands ----------------------------------------------------------------------------------------------

    def _hear(self, received: bytes, begin_ns: int, end_ns: int) -> None:
        if self._booted_ns is None or begin_ns < self._booted_ns + to_ns(BOOT_S):
            return
        receiver = self._receiver
        if begin_ns - receiver.heard_ns > SILENCE_NS:
            receiver.silence()
        for request in receiver.feed(received, end_ns):
            self._take(request, end_ns)
        self._at(end_ns + SILENCE_NS + 1, lambda t_ns: self._fell_silent(receiver, t_ns))

    def _fell_silent(self, receiver: BoardReceiver, t_ns: int) -> None:
        if receiver is self._receiver and t_ns - receiver.heard_ns > SILENCE_NS:
            for request in receiver.silence():
                self._take(request, t_ns)

    def _take(self, request: Request, t_ns: int) -> None:
        """Begin a command, or answer it again; while one is being done nothing else is heard."""
        if self._busy:
            return
        key = (request.source, request.sequence, request.command, request.payload)
        if key in self._answers:
            self._send(self._answers[key], t_ns)
            return
        handler = HANDLERS.get(request.command)
        if handler is None:
            self._refuse(request, Status.UNKNOWN_COMMAND, t_ns)
            return
        try:
            job = handler(self, request.payload)
            duration_s = next(job)
        except BadParameterError:
            self._refuse(request, Status.BAD_PARAMETER, t_ns)
            return
        self._busy = True
        receiver = self._receiver
        self._at(t_ns + to_ns(duration_s), lambda end_ns: self._finish(request, job, end_ns, receiver))

    def _finish(self, request: Request, job: Job, end_ns: int, receiver: BoardReceiver) -> None:
        if receiver is not self._receiver:  # the power was away meanwhile
            return
        self._busy = False
        try:
            job.send(end_ns)
        except StopIteration as done:
            status, payload = done.value
        frame = self._framed(request, "answer", status=int(status), payload=payload)
        self._answers[request.source, request.sequence, request.command, request.payload] = frame
        if len(self._answers) > KEPT_ANSWERS:
            self._answers.popitem(last=False)
        self._send(frame, end_ns)

    def _refuse(self, request: Request, status: Status, t_ns: int) -> None:
        self._send(self._framed(request, "refusal", status=int(status)), t_ns)

    def _framed(self, request: Request, message: str, **fields: object) -> bytes:
        head = {"destination": request.source, "source": BOARD, "sequence": request.sequence}
        return self.definition.encode_one({**head, "command": request.command, **fields}, message)

    def _send(self, frame: bytes, t_ns: int) -> None:
        self.port.append(np.array([t_ns], np.int64), np.frombuffer(frame, np.uint8).reshape(1, -1))

    # --- streams -----------------------------------------------------------------------------------------------

    def start_stream(self, sensors: int, rate_Hz: int, samples: int, t_ns: int) -> None:
        """Send samples from now on, instead of those of an earlier stream; called by the command."""
        assert self._booted_ns is not None
        self._end_stream()
        start_ns = t_ns + to_ns(STREAM_S)
        error = self.module.crystal_error(t_ns)
        tick_us = (start_ns - self._booted_ns) * (1.0 + error) / NS * US
        self._sent = 0
        self.stream = Stream(self.module, sensors, rate_Hz, samples, start_ns, tick_us, error, 0x01, self._counted)

    def stop_stream(self) -> int:
        """End the stream; returns how many samples it has sent since it was started."""
        self._end_stream()
        return self._sent

    def _end_stream(self) -> None:
        if self.stream is not None:
            self._sent = self.stream.sent
            self._counted += self._sent
            self.stream = None


SITE = Site(latitude_deg=34.2, gravity_m_s2=9.7969, azimuth_deg=90.0)
LONGITUDE_DEG, HEIGHT_M = 108.9, 400.0
FIRST_UNIT = "GNC-01"  # in the socket until somebody puts in another one
MOUNTINGS = ("x", "y", "z")
TABLES = ("turntable", "non_magnetic", "bench")
SWITCHES = 5
_SWITCHES = {text: number for number in range(SWITCHES + 1) for text in (f"{number}", f"{number}.0")}


class GncWorld(World):
    """One simulated GNC bench.

    Args: clock, seed: as of every world.   options: checked ones; switches that are not given are on.
    Attributes: motion: of the table's axes outer, middle, inner.   mounting: body axis along the inner axis.
        table: what the board lies on.   dip_switch: the one that is on, 0 for none.
    Raises: InputError B-SIM-002, a fault that does not exist.
    """

    ports = (PORT,)

    def __init__(self, *, clock: Clock, seed: int, options: Mapping[str, Any]) -> None:
        self._faults_of = parse_faults(str(options.get("faults", "")))
        self._imu_options = ImuOptions(
            errors=bool(options.get("imu_errors", True)),
            noise=bool(options.get("noise", True)),
            tilt_arcmin=float(options.get("tilt_arcmin", 0.0)),
        )
        self.motion = (AxisMotion(), AxisMotion(), AxisMotion())
        self.mounting, self.table, self.dip_switch = "x", "bench", 0
        self._imus: dict[str, GncImu] = {}
        self._modules: dict[str, GncModule] = {}
        self.board = GncBoard(clock, self._module(FIRST_UNIT, seed), lambda: self.dip_switch)
        super().__init__(clock=clock, seed=seed, unit=self.board, thermal=Thermal(), options=options)

    def _insert(self, serial: str) -> None:
        self.board.settle()
        if serial != self.board.module.serial:
            self.board.insert(self._module(serial, self.seed))

    def _set(self, **changed: Any) -> None:
        self.board.settle()
        vars(self).update(changed)

    operations: ClassVar[Mapping[str, Operation]] = {
        "unit": Operation(_insert, lambda value: _serial(str(value)), "a serial number of 1 to 12 characters"),
        "dip_switch": Operation(
            lambda world, number: world._set(dip_switch=number), lambda value: _SWITCHES.get(str(value)),
            f"0 (none) to {SWITCHES}"),
        "mounting": Operation.word(lambda world, axis: world._set(mounting=axis), *MOUNTINGS),
        "table": Operation.word(lambda world, table: world._set(table=table), *TABLES),
    }  # fmt: skip

    @property
    def load(self) -> tuple[float, float]:
        return START_V, self.board.module.power.current_A

    @property
    def rail_V(self) -> float:
        return self.board.board_V

    def truth(self, windows: Sequence[RecordWindow]) -> list[dict[str, Any]]:
        first = self.board.module.serial  # what a window without a unit means: the session's only one
        return estimates({first: self._imus[first], **self._imus}, windows)

    def _module(self, serial: str, seed: int) -> GncModule:
        """Return the module of a serial number; one that comes back is the same one."""
        if serial not in self._modules:
            imu = GncImu(seed, serial, self._imu_options, self, SITE)
            place = (SITE.latitude_deg, LONGITUDE_DEG, HEIGHT_M)
            self._imus[serial] = imu
            self._modules[serial] = GncModule(seed, serial, self._faults_of.get(serial, ()), imu, place)
        return self._modules[serial]


def _serial(text: str) -> str | None:
    return text if 0 < len(text) <= 12 and text.isascii() else None


WORLD = GncWorld
