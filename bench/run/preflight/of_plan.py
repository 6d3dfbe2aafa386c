"""What the plan itself says about its beginning."""

from __future__ import annotations

from bench.run.preflight.context import PreflightContext
from bench.run.preflight.finding import Finding, Status


def wiring(context: PreflightContext) -> Finding:
    """The preparation proves by small known currents that every wire goes where it should."""
    checks = [step for step in context.plan.phase("prepare") if step.arguments.get("purpose") == "wiring"]
    channels = sorted({int(step.conditions["channel"]) for step in checks if "channel" in step.conditions})
    if checks:
        return Finding("wiring check", Status.OK, f"{len(checks)} records, {len(channels)} channels", "in 'prepare'")
    driven = any(step.name == "operate" for step in context.plan.steps)
    if not driven:
        return Finding("wiring check", Status.SKIPPED, "none", "in 'prepare'", "the plan drives no current")
    text = "no record in 'prepare' has the purpose wiring: a swapped wire would show only in the results"
    return Finding("wiring check", Status.WARN, "none", "in 'prepare'", text)
