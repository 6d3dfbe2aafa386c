"""A short recorded run with its trend, and frames with known values."""

from pathlib import Path

from bench.frame import FrameDefinition, LinkBatch, LinkDecoder, load_frame
from bench.model.clock import NS, VirtualClock
from bench.plan import Plan, Step, compile_sequence
from bench.record import RecordRow
from bench.run.besides import besides
from bench.run.operator import SimulatedOperator
from bench.run.session import Beside, Conducted, conduct

ROOT = Path(__file__).resolve().parents[3]
FRAMES = {name: load_frame(ROOT / "frames" / f"ngu_{name[-1]}.yaml") for name in ("port_a", "port_b")}
UTC_S = 946_684_800  # 2000-01-01


class Heard:
    """A listener that keeps what is said."""

    def __init__(self) -> None:
        self.said: list[str] = []

    def step(self, step: Step, at_s: float) -> None:
        """Nothing to keep."""

    def record(self, row: RecordRow) -> None:
        """Nothing to keep."""

    def message(self, text: str) -> None:
        self.said.append(text)


def short_plan() -> Plan:
    return compile_sequence(ROOT / "sequences" / "scale_factor_wall_30s.yaml", None, {})


def run_short(out: Path, *, beside: list[Beside] | None = None, seed: int = 3) -> tuple[Conducted, Heard]:
    """Rehearse half a minute of a campaign."""
    plan, heard = short_plan(), Heard()
    done = conduct(
        plan, clock=VirtualClock(), seed=seed, out=out, operator=SimulatedOperator(), listener=heard,
        beside=besides(plan, {}, virtual=True) if beside is None else beside,
    )  # fmt: skip
    assert done.outcome.error is None
    return done, heard


def batch_of(definition: FrameDefinition, raw: bytes, stamp_s: float) -> LinkBatch:
    """Frames that were received at one time."""
    decoder = LinkDecoder(definition)
    decoder.push(round(stamp_s * NS), raw)
    return decoder.flush()
