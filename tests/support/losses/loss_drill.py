"""Runs of half a minute on a served bench that lose their network, and a person who comes when it is back.

``make losses`` drills 200 seeds and adds a row for each to tests/fault/losses.csv; it can be stopped at any time and
goes on where the rows end. What was wrong is kept below build/losses.
"""

import argparse
import json
import math
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # this revision is drilled, whichever is installed
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from block_rows import ROOT, add_row, read_rows, revision_of
from loss_bench import possible_kinds
from loss_judge import Recording, Span, Verdict, judge
from loss_run import Drill
from loss_schedule import (
    ALL,
    CLOSING,
    FEW_SERVERS,
    HOLDING,
    KINDS,
    SCALES,
    Kind,
    Loss,
    PlanStep,
    Scale,
    drawn,
    scale_of,
)
from plan_sample import WALL_30_s, one_temperature

from bench.plan import compile_sequence, load_station

ROWS = ROOT / "tests" / "fault" / "losses.csv"
KEEP = ROOT / "build" / "losses"
JUDGED = ("bench", "instruments", "sim_instruments", "sequences", "stations", "tests/support/losses")
STATION = ROOT / "stations" / "af_rack_sim.yaml"
COUNT, BENCHES = 200, 6
STOPPED = 130
MISSED = "missed"  # in place of the exit status: the run had ended before the moment of the loss


@dataclass(frozen=True)
class Row:
    """One loss and what came of it; seconds are NaN where nothing was driven. ``step``: at which it came.

    ``gap_s``: the longest time between two looks at the world, which are 0.2 s apart on a machine that has the time.
    """

    seed: int
    scale: str
    target: str
    kind: str
    moment: str
    step: int
    length_s: float
    path_open_s: float
    off_after_s: float
    exit: str
    guard: str
    resumed: str
    replay: str
    violations: str
    revision: str = ""
    gap_s: float = 0.0


def steps_of(sequence: Path) -> list[PlanStep]:
    """Return the steps of a sequence as a schedule wants them."""
    plan = compile_sequence(sequence, load_station(STATION))
    return [PlanStep(step.number, step.kind, step.role, step.duration_s) for step in plan.steps]


def drilled(folder: Path, seeds: Sequence[int], scale: Scale, bare: bool = False) -> list[Row]:
    """Run once, with the losses of these seeds in their order in the plan; return a row for each.

    Args: bare: nothing is lost, all else is the same.
    """
    folder.mkdir(parents=True)
    sequence = one_temperature(folder) if scale.short else WALL_30_s
    steps = steps_of(sequence)
    kinds: tuple[Kind, ...] = ("none",) if bare else possible_kinds(FEW_SERVERS if scale.short else KINDS)
    roles = tuple(load_station(STATION).instruments)
    losses = [drawn(seed, steps, scale, roles, kinds, (number, len(seeds))) for number, seed in enumerate(seeds)]
    if sum(loss.kind == "down" for loss in losses) > 1:  # there is one cable for what is lost
        losses = [replace(loss, target=ALL) if loss.kind == "down" else loss for loss in losses]
    drill = Drill(folder, scale, losses, sequence)
    try:
        spans = drill.spans()
        drill.end()
        recording = drill.recording()
    finally:
        drill.close()
        drill.write(folder / "seen.txt")
    spans = [_named(span, steps) for span in spans]
    (folder / "losses.txt").write_text("\n".join(map(str, [*spans, replace(recording, samples=()), ""])))
    came = {span.loss.seed: _row(span, scale, recording, judge(span, recording)) for span in spans}
    return [came.get(loss.seed) or _missed(loss, scale) for loss in losses]


def _named(span: Span, steps: Sequence[PlanStep]) -> Span:
    """Return a loss with the kind of the step at which it really came; two of one run may push each other along."""
    loss = span.loss
    kind = loss.moment if loss.moment in (HOLDING, CLOSING) or loss.step < 0 else steps[loss.step].kind
    return replace(span, loss=replace(loss, moment=kind))


def _row(span: Span, scale: Scale, recording: Recording, verdict: Verdict) -> Row:
    loss = span.loss
    first, *others = [*map(str, recording.exits), ""]
    return Row(
        loss.seed, scale.name, loss.target, loss.kind, loss.moment, loss.step, loss.length_s,
        round(verdict.path_open_s, 1), round(verdict.off_after_s, 1), first, recording.guard,
        " ".join(filter(None, others)), recording.replay, "; ".join(verdict.violations),
        gap_s=round(max((b.t_s - a.t_s for a, b in pairwise(recording.samples)), default=0.0), 1),
    )  # fmt: skip


def _missed(loss: Loss, scale: Scale) -> Row:
    place = loss.target, loss.kind, loss.moment, loss.step, loss.length_s
    return Row(loss.seed, scale.name, *place, math.nan, math.nan, MISSED, "", "", "", "")


Job = tuple[Sequence[int], Scale]


def drill_all(jobs: Sequence[Job], benches: int, out: Path, apart_s: float = 1.0) -> Iterable[list[Row]]:
    """Drill each job (seeds of one run, scale) in a process of its own, several side by side; yield rows as they come.

    A job that could not be drilled says why and has no rows. Args: apart_s: the first ones begin so far apart, so that
    not all of them are loaded at once.
    """

    def one(number: int) -> list[Row]:
        time.sleep(apart_s * number if number < benches else 0.0)
        seeds, scale = jobs[number]
        folder = out / f"seed{seeds[0]}"
        shutil.rmtree(folder, ignore_errors=True)
        words = [str(folder), scale.name, *map(str, seeds)]
        done = subprocess.run([sys.executable, __file__, "--one", *words], capture_output=True, text=True, check=False)
        if done.returncode != 0:
            print(f"seeds {list(seeds)} were not drilled: {done.stderr[-2000:]}", file=sys.stderr)
            return []
        rows = [Row(**document) for document in json.loads(done.stdout.splitlines()[-1])]
        if not any(row.violations for row in rows):
            shutil.rmtree(folder)
        return rows

    with ThreadPoolExecutor(benches) as workers:
        try:
            for done in as_completed([workers.submit(one, number) for number in range(len(jobs))]):
                yield done.result()
        finally:
            workers.shutdown(cancel_futures=True)


def told(row: Row) -> str:
    """Return one line about a loss."""
    length = "for good" if math.isinf(row.length_s) else f"{row.length_s:g} s"
    times = f"path open {row.path_open_s:g} s, off {row.off_after_s:g} s after"
    ends = f"exit {row.exit or '-'} {row.resumed}, guard {row.guard}, replay {row.replay[:20]}"
    where = f"{row.kind} {row.target} at {row.moment} (step {row.step})"
    outcome = "" if row.exit == MISSED else f"{times}; {ends}; {row.violations or 'right'}"
    return f"{row.seed}: {where} {length}: {outcome or MISSED}"


def summary(rows: Sequence[Row]) -> str:
    """Return a table in Markdown: by kind, of how many losses, how long it took, what was wrong."""
    lines = [
        "| loss | number | path open, median, max | off behind it, median, max | held, went on | resumed | wrong |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in sorted({row.kind for row in rows}):
        those = [row for row in rows if row.kind == kind and row.exit != MISSED]
        went_on = sum(row.exit in ("0", "1") for row in those)
        wrong = sum(bool(row.violations) for row in those)
        times = (_spread([row.path_open_s for row in those]), _spread([row.off_after_s for row in those]))
        resumed = sum(bool(row.resumed) for row in those)
        lines.append(f"| {kind} | {len(those)} | {' | '.join(times)} | {went_on} | {resumed} | {wrong} |")
    return "\n".join(lines)


def _spread(values: Iterable[float]) -> str:
    there = [value for value in values if not math.isnan(value)]
    return f"{statistics.median(there):.1f} s, {max(there):.1f} s" if there else "-"


def main(words: Sequence[str]) -> int:
    """Drill what is left of the seeds; return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT, help="seeds, from 0 on, that shall stand in the file")
    parser.add_argument("--benches", type=int, default=BENCHES, help="how many side by side")
    parser.add_argument("--seeds", type=int, nargs="*", help="these only, and no rows are written")
    parser.add_argument("--scale", choices=SCALES, help="of --seeds; else as in the whole drill")
    parser.add_argument("--one", nargs="+", metavar="WORD", help="folder, scale and seeds of one run; prints JSON")
    asked = parser.parse_args(words)
    if asked.one:
        folder, scale, *seeds = asked.one
        rows = drilled(Path(folder), [int(seed) for seed in seeds], SCALES[scale])
        print(json.dumps([asdict(row) for row in rows]))
        return 0
    return _whole(asked.count, asked.benches, asked.seeds, asked.scale)


def _whole(count: int, benches: int, seeds: Sequence[int] | None, scale: str | None) -> int:
    stand = {row.seed for row in read_rows(Row, ROWS)}
    left = [seed for seed in range(count) if seed not in stand] if seeds is None else list(seeds)
    jobs = [([seed], SCALES[scale] if scale else scale_of(seed)) for seed in left]
    revision, rows = revision_of(JUDGED), []
    try:
        for done in drill_all(jobs, benches, KEEP):
            for row in done:
                rows.append(replace(row, revision=revision))
                print(told(row), flush=True)
                if seeds is None:
                    add_row(rows[-1], ROWS)
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here")
        return STOPPED
    rows = rows if seeds is not None else read_rows(Row, ROWS)
    print(summary(rows))
    return int(any(row.violations for row in rows) or len(rows) < len(seeds or range(count)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
