"""A short recorded run with its trend, and frames with known values."""

from pathlib import Path

from rehearsal import Watched, rehearsed

from bench.frame import FrameDefinition, LinkBatch, LinkDecoder, load_frame
from bench.model.clock import NS
from bench.plan import Plan, compile_sequence
from bench.run.besides import besides
from bench.run.session import Beside, Conducted

ROOT = Path(__file__).resolve().parents[3]
FRAMES = {name: load_frame(ROOT / "frames" / f"ngu_{name[-1]}.yaml") for name in ("port_a", "port_b")}
UTC_S = 946_684_800  # 2000-01-01


def short_plan() -> Plan:
    return compile_sequence(ROOT / "sequences" / "scale_factor_wall_30s.yaml", None, {})


def run_short(out: Path, *, beside: list[Beside] | None = None) -> tuple[Conducted, Watched]:
    """Rehearse half a minute of a campaign."""
    plan = short_plan()
    done = rehearsed(out, plan, seed=3, beside=besides(plan, {}, virtual=True) if beside is None else beside)
    assert done.run.outcome.error is None
    return done.run, done.watched


def batch_of(definition: FrameDefinition, raw: bytes, stamp_s: float) -> LinkBatch:
    """Frames that were received at one time."""
    decoder = LinkDecoder(definition)
    decoder.push(round(stamp_s * NS), raw)
    return decoder.flush()
