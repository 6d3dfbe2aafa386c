"""Row 30: benches whose network is lost, in every way and at every moment; what the worlds do then, not what is said.

Nine losses of some seconds here, of each kind, three in each run, several benches side by side, and twenty in the
sweep; ``make losses`` has 200 of up to five minutes and for good, one in each run. Behind them the judge on series made
by hand, what is drawn by a seed, and the proxies: without a bench.
"""

import math
import os
import socket
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from socketserver import BaseRequestHandler, ThreadingTCPServer

import pytest
from loss_bench import Proxies
from loss_drill import MISSED, drill_all, drilled, summary, told
from loss_judge import Kept, Recording, Sample, Span, Verdict, judge, point_of
from loss_schedule import ALL, FULL, KINDS, SCALED, SHORT, Kind, Loss, PlanStep, drawn, scale_of

DRIVEN = ((15, 33, 53), (47, 11, 17), (98, 10, 43))  # seeds of three runs: each kind, and all while a current flows
TWENTY = tuple(range(seed, min(seed + 3, 20)) for seed in range(0, 20, 3))
STARVED_S = 1.0
BENCHES = 7  # side by side: each costs a tenth of a core


@pytest.mark.waits
@pytest.mark.slow
@pytest.mark.parametrize("runs", [DRIVEN, pytest.param(TWENTY, marks=pytest.mark.sweep)], ids=["few", "twenty"])
def test_losses(tmp_path: Path, runs: Sequence[Sequence[int]]) -> None:
    rows = [row for done in drill_all([(seeds, SHORT) for seeds in runs], BENCHES, tmp_path) for row in done]
    print("\n".join(map(told, rows)))
    print(summary(rows))
    assert len(rows) == sum(map(len, runs))
    missed = sum(row.exit == MISSED for row in rows)  # a run that survives one goes on meanwhile
    assert missed <= 0.15 * len(rows)
    starved = [row for row in rows if row.gap_s > STARVED_S]  # no processor: deadlines say nothing, kills are right
    print(f"{len(starved)} on a machine without time")
    assert len(starved) <= len(rows) // 2 or os.getloadavg()[0] > 2 * (os.cpu_count() or 1)
    assert [told(row) for row in rows if row.violations and row not in starved] == []


@pytest.mark.waits
@pytest.mark.sweep
def test_a_run_that_loses_nothing_is_right(tmp_path: Path) -> None:
    (row,) = drilled(tmp_path / "bare", [0], SHORT, bare=True)
    assert row.violations == ""
    assert row.exit in ("0", "1")  # a machine without time leaves records that are flagged


ROLES = ("calibrator", "switch", "supply")
BOTH = frozenset({"calibrator", "switch"})
NONE: frozenset[str] = frozenset()
STEPS = [
    PlanStep(number, kind, role, length_s)
    for number, (kind, role, length_s) in enumerate(
        [("prompt", "", 0.0), ("call", "calibrator", 0.0), ("unit", "", 0.0), ("soak", "", 3.0)]
        + 4 * [("call", "switch", 0.0), ("call", "calibrator", 0.0), ("settle", "", 1.45), ("record", "port_a", 0.5)]
        + [("verify", "calibrator", 0.0)]
    )
]
On = Callable[[float], frozenset[str] | None]


def span(target: str = "calibrator", kind: Kind = "mute", length_s: float = 20.0, moment: str = "settle") -> Span:
    """Return a loss that begins at second 100."""
    return Span(Loss(1, target, kind, moment, 5, 0.0, length_s), 100.0, 100.0 + length_s)


def series(on: On, begin_s: float = 95.0, end_s: float = 160.0, **others: object) -> list[Sample]:
    """Return a sample each 0.2 s of a world in which ``on`` says what drives."""
    times_s = [begin_s + 0.2 * number for number in range(round((end_s - begin_s) / 0.2))]
    return [Sample(t_s, on(t_s), **others) for t_s in times_s]  # type: ignore[arg-type]


def until(off_s: float, roles: Iterable[str] = BOTH, again_s: float = math.inf) -> On:
    """Roles drive until one second, and all of the stimulus again from another one on."""
    return lambda t_s: frozenset(roles) if t_s < off_s else BOTH if t_s >= again_s else NONE


def judged(one: Span, on: On, **others: object) -> Verdict:
    samples = series(on)
    return judge(one, Recording(samples, ROLES, exits=(0,), **others))  # type: ignore[arg-type]


def test_a_path_that_is_open_in_time_and_a_person_who_arms_is_right() -> None:
    verdict = judged(span(), until(103.0, again_s=130.0), holds=[102.0], armed=[129.0])
    assert verdict.violations == []
    assert verdict.path_open_s == pytest.approx(2.8)
    assert verdict.off_after_s == 0.0


def test_a_path_that_stays_closed_for_longer_is_wrong_unless_nothing_can_open_it() -> None:
    late = until(107.0, again_s=130.0)
    assert judged(span(), late, holds=[102.0], armed=[129.0]).violations == ["current for 6.8 s of the loss"]
    assert judged(span(ALL), late, holds=[102.0], armed=[129.0]).violations == []


def test_a_relay_that_is_open_is_no_current_but_the_calibrator_is_due_when_it_is_back() -> None:
    def on(t_s: float) -> frozenset[str]:
        return BOTH if t_s < 103.0 else frozenset({"calibrator"}) if t_s < off_s else NONE

    off_s = 124.0
    verdict = judged(span(), on, holds=[102.0], tries=[113.0])
    assert verdict.violations == []
    assert verdict.off_after_s == pytest.approx(3.8)
    off_s = 126.0
    found = judged(span(), on, holds=[102.0], tries=[113.0]).violations
    assert found == ["calibrator on behind the loss, no person there: the run stood still"]


def test_nothing_is_driven_before_somebody_arms() -> None:
    found = judged(span(), until(103.0, again_s=130.0), holds=[102.0]).violations
    assert found == ["calibrator on behind the loss, no person there: the run stood still"]
    by_itself = {"holds": [102.0], "unasked_s": 90.0, "breaks": [129.0]}  # a resumed run of a simulated bench
    assert judged(span(), until(103.0, again_s=130.0), **by_itself).violations == []
    paused = replace(span(), loss=replace(span().loss, moment="holding"))
    assert judged(paused, until(95.0, again_s=130.0)).violations != []


def test_a_short_loss_that_the_bus_survives_is_its_own_way_back_and_a_long_one_is_not() -> None:
    assert judged(span(length_s=3.0), lambda _: BOTH).violations == []
    found = judged(span(ALL, length_s=8.0), lambda _: BOTH).violations
    assert found == ["calibrator+switch on behind the loss, no person there: as if nothing had been"]
    assert judged(span(ALL, length_s=8.0), until(95.0, again_s=112.0)).violations == []  # nobody had noticed anything


@pytest.mark.parametrize(("length_s", "kept"), [(4.0, True), (8.0, False)])
def test_a_point_without_its_calibrator_is_taken_again(length_s: float, kept: bool) -> None:
    samples = [replace(one, step=8 + (one.t_s >= 112.0)) for one in series(until(95.0), 99.0)]
    recording = Recording(samples, ROLES, exits=(0,), kept=[Kept(3, 8, 9, 10, 113.0, 113.5)])
    assert point_of(recording.kept[0], recording)[0] == pytest.approx(99.0)
    assert (judge(span(length_s=length_s), recording).violations == []) == kept
    assert judge(span(length_s=length_s), replace(recording, breaks=[110.0])).violations == []  # it was begun again
    assert judge(span("switch", length_s=length_s), recording).violations == []


def test_whoever_is_left_still_tries_and_tells() -> None:
    on: On = until(125.0, {"calibrator"})
    assert judged(span(), on, holds=[101.0], tries=[115.0]).violations == []
    assert judged(span(), on, holds=[101.0]).violations == ["nobody tried in the last 10 s of the loss"]
    gone = series(on, run=False, guard=False)
    found = judge(span(), Recording(gone, ROLES, exits=(70,))).violations
    assert "nobody is left at the end of the loss" in found
    assert any(text.startswith("no guard for") for text in found)
    assert "internal error, exit 70" in found


def test_nothing_is_on_behind_the_end_of_a_run() -> None:
    supply = series(until(112.0, {"supply"}), run=False)
    assert judge(span(), Recording(supply, ROLES, exits=(3,))).violations == ["supply on, and no run"]
    assert judge(span("supply"), Recording(supply, ROLES, exits=(3,))).violations == []  # nobody could reach it


def test_no_view_shows_off_what_is_on() -> None:
    samples = series(lambda _: frozenset({"supply"}))
    shown = [replace(one, off=frozenset({ALL}) if one.t_s > 110.0 else NONE) for one in samples]
    found = judge(span("dmm"), Recording(shown, ROLES, exits=(0,))).violations
    assert found == ["a view shows supply as off while it is on"]
    lags = [replace(one, off=frozenset({"supply"}) if one.t_s < 100.5 else NONE) for one in samples]
    assert judge(span("dmm"), Recording(lags, ROLES, exits=(0,))).violations == []


def test_the_ends_that_are_wrong() -> None:
    def found(**others: object) -> list[str]:
        return judge(span("dmm"), Recording(series(until(0.0)), ROLES, **others)).violations  # type: ignore[arg-type]

    assert found(exits=(0,)) == found(exits=(3, 0)) == found(exits=(1,), replay="no results") == []
    assert found(exits=(-9, 0)) == ["killed by its guard"]
    assert found(exits=(3,), ended=False) == ["neither closed nor gone on with"]
    assert found(exits=(0,), replay="no results") == ["replay: no results"]


def test_two_hundred_seeds_have_every_kind_and_moment_and_forty_are_full() -> None:
    losses = [drawn(seed, STEPS, scale_of(seed), ROLES, KINDS) for seed in range(200)]
    assert losses == [drawn(seed, STEPS, scale_of(seed), ROLES, KINDS) for seed in range(200)]
    assert {loss.kind for loss in losses} == set(KINDS)
    moments = {"prompt", "call", "settle", "record", "verify", "unit", "soak", "holding", "closing"}
    assert {loss.moment for loss in losses} == moments
    assert sum(scale_of(seed) is FULL for seed in range(200)) == 40
    assert {loss.kind for loss in losses if scale_of(loss.seed) is FULL} == set(KINDS)
    assert {loss.length_s for loss in losses} == {0.0, *FULL.lengths_s, *SCALED.lengths_s}
    assert all(loss.target == ALL for loss in losses if loss.kind == "server")


class Echo(BaseRequestHandler):
    """Says everything again."""

    def handle(self) -> None:
        with suppress(OSError):
            while chunk := self.request.recv(100):
                self.request.sendall(chunk)


def connected(proxies: Proxies, role: str, patience_s: float = 5.0) -> socket.socket:
    return socket.create_connection(proxies.places[role], timeout=patience_s)


def echoed(client: socket.socket) -> bytes:
    client.sendall(b"x")
    return client.recv(10)


def test_a_role_is_lost_in_each_way_and_comes_back_at_its_port() -> None:
    with ThreadingTCPServer(("127.0.0.1", 0), Echo) as server, ExitStack() as ends:
        ends.callback(server.shutdown)
        threading.Thread(target=server.serve_forever, daemon=True).start()
        proxies = Proxies({"one": "127.0.0.1", "other": "127.0.0.1"}, server.server_address[1])
        ends.callback(proxies.close)
        one, other = (ends.enter_context(connected(proxies, role)) for role in ("one", "other"))
        assert echoed(one) == echoed(other) == b"x"
        proxies.cut(["one"])
        with pytest.raises(ConnectionResetError):
            one.recv(1)
        one = ends.enter_context(connected(proxies, "one", 0.3))
        assert echoed(one) == echoed(other) == b"x"
        proxies.mute(["one"])
        with pytest.raises(TimeoutError):
            echoed(one)
        with connected(proxies, "one"):  # taken, and nothing comes
            proxies.restore(["one"])
            one.settimeout(5.0)
            assert one.recv(10) == b"x"  # what was said meanwhile
        proxies.refuse(["one"])
        with pytest.raises(ConnectionRefusedError):
            connected(proxies, "one")
        proxies.restore(["one"])
        proxies.reset(["one"])
        with pytest.raises(ConnectionResetError), connected(proxies, "one") as taken:
            taken.recv(1)
        proxies.restore(["one"])
        assert echoed(ends.enter_context(connected(proxies, "one"))) == echoed(other) == b"x"
