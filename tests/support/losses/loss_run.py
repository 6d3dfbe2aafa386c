"""One run on a bench that loses its network: the moments of its losses, the person who comes, and what is seen."""

import json
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from block_rows import ROOT
from loss_bench import LOOK_S, LossyBench
from loss_judge import NO_RESULTS, Kept, Recording, Sample, Span
from loss_schedule import ALL, CLOSING, HOLDING, Loss, Scale

from bench.commands.control import ask as ask_run
from bench.model.clock import NS
from bench.model.errors import BenchError
from bench.record import SessionReader
from bench.run.control.client import FeedClient
from bench.run.guard.diary import DIARY, read_diary
from bench.session.recorded_state import RecordedState, read_recording, scenery_of

ASK_S, FEED_EACH = 0.07, 3  # between two questions for the status; the feed is asked with each third
FRESH_S = 0.5  # a view that was asked for longer ago says nothing of now: this machine had no time
PROMPT_S = 2.0  # a person who is asked when the network goes answers so much later
LONGEST_S = 300.0  # from the last loss to the end
MOST_TIMES = 5  # that a run is begun or gone on with
REFUSED, CLOSED, BUSY = 2, "B-RES-001", "B-RUN-080"  # it has ended already; a machine too busy for a pre-flight
IDENTICAL = "every number is identical"


class Drill:
    """One run with its losses; everything that is seen of it, and the person who comes."""

    def __init__(self, folder: Path, scale: Scale, losses: Sequence[Loss], sequence: Path) -> None:
        self._out, self._scale, self._losses = folder / "out", scale, losses
        self._seen: list[Sample] = []
        self._status: dict[str, Any] = {}
        self._off: tuple[float, frozenset[str]] = (-math.inf, frozenset())  # what views show, and since when
        self._armed: list[float] = []
        self._exits: list[int] = []
        self._unasked_s = math.inf
        self._begun, self._finished = 1, False
        self._held_s = math.inf
        self._noted: subprocess.Popen[bytes] | None = None  # the last process whose end is noted
        self._person_s = self._answer_s = -math.inf  # from when on somebody arms and resumes; answers other prompts
        self._awaited: Loss | None = None  # whose prompt nobody answers before it comes
        self._over = threading.Event()
        apart = next((loss.target for loss in losses if loss.kind == "down"), None)
        self.bench = LossyBench(folder / "bench", losses[0].seed, apart, self._saw)
        place = ["--station", str(self.bench.station), "--out", str(self._out)]
        self._words = ["run", str(sequence), *place, "--clock", "wall", "--ask"]
        self._log = folder / "said.txt"
        self._run = self._started(*self._words)
        self._watch = threading.Thread(target=self._views, name="views", daemon=True)
        self._watch.start()

    def spans(self) -> list[Span]:
        """Let every loss come and go; return when they were. One whose moment did not come any more is left out."""
        spans: list[Span] = []
        for loss in self._losses:
            if not self._comes(loss):
                continue
            self._person_s = math.inf
            begin_s = time.monotonic()
            step = self._status.get("step")
            self._answer_s = begin_s + PROMPT_S
            self.bench.lose(loss)
            self._attend(begin_s + (self._scale.good_s if math.isinf(loss.length_s) else loss.length_s))
            self.bench.restore(loss)
            end_s = time.monotonic()
            self._person_s = end_s + self._scale.look_s
            self._attend(self._person_s)
            if spans:
                spans[-1] = replace(spans[-1], until_s=begin_s)
            spans.append(Span(replace(loss, step=-1 if step is None else step), begin_s, end_s))
        return spans

    def end(self) -> None:
        """See the run to its end, at most five minutes."""
        end_s = time.monotonic() + LONGEST_S
        while not self._finished and time.monotonic() < end_s:
            self._tend()
            time.sleep(ASK_S)
        end_s = time.monotonic() + self._scale.look_s
        time.sleep(2 * LOOK_S)
        while self._seen[-1].drives and time.monotonic() < end_s:
            time.sleep(LOOK_S)

    def recording(self) -> Recording:
        """Return everything that was seen, with what the session says. The run has ended."""
        replayed = self._replayed() if self._finished else "not ended"
        events = self._events()
        times = {kind: [t for name, t, _ in events if name == kind] for kind in ("hold", "release", "resume")}
        diary = read_diary(self._folder() / DIARY) if self._folder() else []
        offset_s = time.time() - time.monotonic()
        tries = [datetime.fromisoformat(entry["utc"]).timestamp() - offset_s for entry in diary]
        tries += [t for name, t, fields in events if name == "alarm" and fields.get("what") == "stimulus"]
        return Recording(
            samples=self._seen, roles=self.bench.roles, armed=self._armed, unasked_s=self._unasked_s,
            holds=times["hold"], breaks=times["release"] + times["resume"], tries=tries,
            kept=_kept(events, self._plan()), exits=self._exits, guard=str(diary[-1]["what"]) if diary else "none",
            ended=self._finished, replay=replayed,
        )  # fmt: skip

    def write(self, path: Path) -> None:
        """Write every sample as a line, for whoever looks for a cause."""
        seen = (
            f"{one.t_s:.2f} step {one.step} run {one.run:d} guard {one.guard:d} "
            f"on {'no world' if one.drives is None else ' '.join(sorted(one.drives))}; off {' '.join(sorted(one.off))}"
            for one in self._seen
        )
        path.write_text("\n".join([*seen, ""]))

    def close(self) -> None:
        """End what is left of the run and of its bench."""
        self._over.set()
        self._watch.join()
        if self._run.poll() is None:
            self._run.kill()
            self._run.wait()
        for pid in self._guards():
            with suppress(ProcessLookupError):
                os.kill(pid, 9)
        self.bench.close()

    # --- the moment of a loss, and the person ---------------------------------------------------------------------

    def _comes(self, loss: Loss) -> bool:
        """Wait for the moment of a loss; False if the run has ended before."""
        self._awaited = loss
        end_s = time.monotonic() + LONGEST_S
        while time.monotonic() < end_s and not self._finished:
            if self._is_there(loss):
                self._awaited = None
                break
            self._tend()
            time.sleep(ASK_S / 2)
        else:
            return False
        if loss.moment == HOLDING:
            self._pause()
        self._attend(time.monotonic() + loss.delay_s)
        return True

    def _is_there(self, loss: Loss) -> bool:
        state, step, prompt = (self._status.get(name) for name in ("state", "step", "prompt"))
        if loss.moment == CLOSING:
            return state == "ending"
        if state != "running" or step is None or (prompt and prompt["arms"]):
            return False
        return step >= loss.step and (loss.moment != "prompt" or step > loss.step or prompt is not None)

    def _pause(self) -> None:
        self._person_s = math.inf
        with suppress(BenchError):
            ask_run(self._session(), "pause", "a drill")
        end_s = time.monotonic() + 10.0
        while self._status.get("state") != "holding" and time.monotonic() < end_s:
            time.sleep(ASK_S)
        time.sleep(1.0)

    def _attend(self, until_s: float) -> None:
        while (left_s := until_s - time.monotonic()) > 0:
            self._tend()
            time.sleep(min(ASK_S, left_s))

    def _tend(self) -> None:
        """Do what a person does: answer, arm, resume; never before the loss is over and was looked at."""
        if self._run.poll() is not None:
            self._go_on()
            return
        now_s, prompt = time.monotonic(), self._status.get("prompt")
        self._held_s = self._held_s if self._status.get("state") == "holding" else now_s  # since when it holds
        with suppress(BenchError):
            if prompt and prompt["arms"]:
                if now_s >= self._person_s:
                    ask_run(self._session(), "answer", prompt=prompt["id"], value="yes")
                    self._armed.append(now_s)
            elif prompt and now_s >= self._answer_s and not self._waits_for_prompt():
                ask_run(self._session(), "answer", prompt=prompt["id"], value=_middle(prompt))
            elif "operator" in self._status.get("reasons", {}) and now_s >= self._person_s:
                self._armed.append(now_s)
                ask_run(self._session(), "resume")
            elif now_s >= max(self._person_s, self._held_s) + self._scale.stuck_s:
                ask_run(self._session(), "abort", "it does not come back")
            else:
                return
            self._status = {}  # of before

    def _waits_for_prompt(self) -> bool:
        loss = self._awaited
        return loss is not None and loss.moment == "prompt" and (self._status.get("step") or 0) >= loss.step

    def _go_on(self) -> None:
        """Note how a process has ended; go on with a run that ended early, once a person may."""
        if self._finished or (self._noted is self._run and time.monotonic() < self._person_s):
            return
        status = self._run.returncode
        said = self._log.read_text(errors="replace").rpartition("$ bench")[2]
        closed = status == REFUSED and CLOSED in said  # there is nothing left to go on with
        if self._noted is not self._run:
            self._noted = self._run
            self._finished = closed or status in (0, 1)
            if not closed and not (status == REFUSED and BUSY in said):
                self._exits.append(status)
        elif self._begun < MOST_TIMES:
            self._begun += 1
            folder = self._folder()
            if folder is None:
                self._run = self._started(*self._words)
                return
            self._unasked_s = min(self._unasked_s, time.monotonic())
            self._run = self._started("resume", str(folder), *_take_over())

    def _started(self, *words: str) -> subprocess.Popen[bytes]:
        with self._log.open("ab") as stream:
            stream.write(f"$ bench {' '.join(words)}\n".encode())
            stream.flush()
            command = [*self.bench.inside, sys.executable, "-m", "bench", *words]
            return subprocess.Popen(command, stdout=stream, stderr=stream, stdin=subprocess.DEVNULL, cwd=ROOT)

    # --- what is seen -------------------------------------------------------------------------------------------

    def _saw(self, t_s: float, drives: frozenset[str] | None) -> None:
        lives = hasattr(self, "_run") and self._run.poll() is None
        guard = any(_lives(pid) for pid in self._guards())
        asked_s, off = self._off
        off = off if t_s - asked_s < FRESH_S else frozenset()
        self._seen.append(Sample(t_s, drives, lives, guard, self._status.get("step"), off))

    def _views(self) -> None:
        """Ask what a terminal and a page ask, until the end; of a run that is over they read its recording."""
        feed, count, over, recorded = None, 0, None, frozenset[str]()
        while not self._over.wait(ASK_S):
            count += 1
            folder, process = self._folder(), self._run
            status: dict[str, Any] = {}
            with suppress(BenchError):
                status = {} if folder is None else ask_run(folder, "status")
            self._status = status
            if folder is None or count % FEED_EACH:
                continue
            asked_s = time.monotonic()
            with suppress(BenchError):
                if process.poll() is None:
                    feed = feed or FeedClient(folder)
                    self._off = asked_s, _shown_off(feed.poll(1 << 40).header["state"])
                    continue
                if over is not process:
                    over, recorded = process, frozenset()
                    recording = read_recording(folder)
                    document = RecordedState(recording, scenery_of(recording)).at(recording.last_utc_s)
                    recorded = _shown_off(document)
                self._off = time.monotonic(), recorded
        if feed is not None:
            feed.close()

    def _guards(self) -> list[int]:
        folder = self._folder()
        entries = read_diary(folder / DIARY) if folder else []
        return [int(entry["pid"]) for entry in entries if entry["what"] == "ready"]

    def _folder(self) -> Path | None:
        folders = sorted(path for path in self._out.glob("2*") if path.is_dir()) if self._out.is_dir() else []
        return folders[-1] if folders else None

    def _session(self) -> Path:
        folder = self._folder()
        assert folder is not None, self._log.read_text()[-600:]
        return folder

    def _replayed(self) -> str:
        if not (self._session() / "results.json").is_file():
            return NO_RESULTS
        command = [sys.executable, "-m", "bench", "replay", str(self._session())]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT)
        return "identical" if IDENTICAL in done.stdout else f"exit {done.returncode}: {done.stderr.strip()[-160:]}"

    def _events(self) -> list[tuple[str, float, dict[str, Any]]]:
        try:
            return [(kind, t / NS, dict(fields)) for kind, t, fields in SessionReader(self._session()).events()]
        except (BenchError, AssertionError):
            return []

    def _plan(self) -> list[dict[str, Any]]:
        try:
            steps: list[dict[str, Any]] = json.loads(SessionReader(self._session()).texts["plan.json"])
        except (BenchError, AssertionError):
            return []
        return steps


def _take_over() -> list[str]:
    """Return the option of ``bench resume`` that takes the bench from a guard that still tries, where there is one."""
    told = subprocess.run(
        [sys.executable, "-m", "bench", "resume", "--help"], capture_output=True, text=True, check=True
    )
    return ["--take-over"] if "--take-over" in told.stdout else []


def _middle(prompt: dict[str, Any]) -> float | str:
    """Return an answer inside the limits of a prompt."""
    low, high = prompt.get("low"), prompt.get("high")
    if not prompt.get("unit"):
        return "yes"
    return float(math.sqrt(low * high) if low and high else high / 2 if high else 2 * (low or 0.5))


def _shown_off(document: dict[str, Any]) -> frozenset[str]:
    bench = document["bench"]
    off = {part["role"] for part in bench["parts"] if part["state"] == "off"}
    return frozenset(off | ({ALL} if bench["state"] == "off" else set()))


def _lives(pid: int) -> bool:
    with suppress(OSError, IndexError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def _kept(events: Iterable[tuple[str, float, dict[str, Any]]], plan: Sequence[dict[str, Any]]) -> list[Kept]:
    """Return the records that count at the end, with the steps of their points."""
    kept: dict[int, Kept] = {}
    for name, _, fields in events:
        if name == "retake":
            kept.pop(fields["record"], None)
        elif name == "record" and plan:
            number, step = int(fields["number"]), int(fields["step"])
            checked = step + 1 < len(plan) and plan[step + 1]["kind"] == "verify"
            first = int(plan[step]["arguments"].get("retry_step", step))
            window = fields["t_start_ns"] / NS, fields["t_end_ns"] / NS
            kept[number] = Kept(number, first, step, step + checked, *window)
    return list(kept.values())
