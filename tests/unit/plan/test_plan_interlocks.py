"""Interlocks in YAML: what is read, and every mistake with its place."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_sample import ROOT, SEQUENCE

from bench.model.errors import InputErrors
from bench.model.shipped import find_shipped
from bench.plan import Plan, check_plan, compile_sequence, load_station, summarise, unwatched

AIR = "  air: {signal: lab_air, of: logger, channel: 101, high: 24 degC, action: warn"


def compiled(folder: Path, section: str) -> Plan:
    (folder / "sequences").mkdir()
    path = folder / "sequences" / "sample.yaml"
    path.write_text(SEQUENCE + section)
    return compile_sequence(path, None, {})


def test_a_sequence_adds_to_the_interlocks_of_its_station_and_replaces_by_name(tmp_path: Path) -> None:
    plain = {rule.name: rule for rule in compile_sequence("scale_factor_short", None, {}).interlocks}
    section = (
        "interlocks:\n  chamber_air: {signal: chamber_air, high: 40 degC, release_high: 38 degC, dwell: 2 min, "
        "action: hold}\n  mine: {signal: unit_slope, low: -1 degC/min, high: 1 degC/min, action: warn}\n"
    )
    plan = compiled(tmp_path, section)
    rules = {rule.name: rule for rule in plan.interlocks}
    assert set(rules) == {*plain, "mine"}
    air = rules["chamber_air"]
    assert (air.high, air.release_high, air.low, air.dwell_s, air.release_after_s) == (40.0, 38.0, None, 120.0, 120.0)
    assert (air.action, air.stale_s) == ("hold", None)
    assert rules["mine"].release_low == -1.0
    assert rules["laboratory_air"] == plain["laboratory_air"]
    assert air.where.startswith(str(tmp_path))


def test_interlocks_do_not_change_the_hash_of_the_steps(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    assert compiled(tmp_path, "").sha256 == compiled(other, f"interlocks:\n{AIR}}}\n").sha256


@pytest.mark.parametrize(
    ("section", "code", "words"),
    [
        ("  a: {signal: lab_airr, high: 1 degC, action: warn}", "B-PLAN-080", "did you mean 'lab_air'"),
        ("  a: {signal: link_loss, high: 1 %, action: warn}", "B-PLAN-080", "which link"),
        ("  a: {signal: link_loss, of: port_x, high: 1 %, action: warn}", "B-PLAN-080", "no link 'port_x'"),
        ("  a: {signal: unit_temperature, of: dmm, high: 1 degC, action: warn}", "B-PLAN-080", "needs no 'of'"),
        ("  a: {signal: lab_air, of: logger, high: 1 degC, action: warn}", "B-PLAN-080", "needs a channel"),
        ("  a: {signal: supply_current, action: warn}", "B-PLAN-081", "neither 'high' nor 'low'"),
        (f"{AIR}, release_high: 24.1 degC}}", "B-PLAN-081", "beyond its trip level"),
        (f"{AIR}, low: 22 degC, release_low: 21.9 degC}}", "B-PLAN-081", "beyond its trip level"),
        (f"{AIR}, low: 24 degC}}", "B-PLAN-081", "not below high"),
        (f"{AIR}, release_low: 21 degC}}", "B-PLAN-081", "no 'low' to release from"),
        (f"{AIR}, low: 22 degC, release_low: 23.5 degC, release_high: 23 degC}}", "B-PLAN-081", "never release"),
        (
            "  a: {signal: lab_air, of: dmm, channel: 101, high: 24 degC, action: warn}",
            "B-PLAN-080",
            "scans no channels",
        ),
        (
            "  a: {signal: lab_air, of: logger, channel: 9, high: 24 degC, action: warn}",
            "B-PLAN-080",
            "[101, 102, 103]",
        ),
        ("  a: {signal: supply_current, high: 3 V, action: warn}", "B-PLAN-082", "'3 V'"),
        ("  a: {signal: supply_current, high: much, action: warn}", "B-PLAN-082", "'much'"),
        ("  a: {signal: rate_step, high: 5 Hz, action: retake}", "B-PLAN-083", "too late"),
        ("  a: {signal: supply_current, high: 3 A, action: stop}", "B-YAML-013", "hold"),
        ("  a: {signal: supply_current, high: 3, action: hold}", "B-YAML-013", "high"),
        ("  a: {signal: supply_current, high: 3 A, action: hold, dwell: 10}", "B-YAML-012", "no unit"),
        ("  a: {signal: supply_current, high: 3 A, action: hold, delay: 10 s}", "B-YAML-010", "delay"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, section: str, code: str, words: str) -> None:
    with pytest.raises(InputErrors) as caught:
        compiled(tmp_path, f"interlocks:\n{section}\n")
    found = [one for one in caught.value.errors if one.code == code]
    assert found, caught.value
    assert words in found[0].message
    line = SEQUENCE.count("\n") + 2
    assert f"sample.yaml:{line}:" in found[0].where


def test_a_station_is_checked_for_its_own(tmp_path: Path) -> None:
    for folder in ("sequences", "stations"):
        (tmp_path / folder).mkdir()
    station = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    old = "{signal: unit_temperature, high: 65 degC, dwell: 10 s, action: abort}"
    assert station.count(old) == 1
    wrong = old.replace("high: 65 degC", "high: 65 degC, release_high: 66 degC")
    (tmp_path / "stations" / "af_bench_sim.yaml").write_text(station.replace(old, wrong))
    path = tmp_path / "sequences" / "sample.yaml"
    path.write_text(SEQUENCE)
    found = [(one.code, one.where) for one in check_plan(compile_sequence(path, None, {}))]
    assert [code for code, _ in found] == ["B-PLAN-081"]
    assert "af_bench_sim.yaml:" in found[0][1]


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ("  webhook: {url: http://example.org/hook}", "https"),
        ("  webhook: {url: https://me:word@example.org/hook}", "token_env"),
        ("  webhook: {url: https://example.org/hook, url_env: HOOK}", "either"),
        ("  email: {host: mail.example.org, sender: bench@example.org, to: []}", "to"),
        ("  heartbeat: 1 s", "below the limit"),
        ("  on: [sometimes]", "hold"),
        ("  on: [end]", "nobody is told"),
        ("  email: {host: mail.example.org, sender: b@example.org, to: [b@example.org]}\n  heartbeat: 1 h", "webhook"),
    ],
)
def test_a_wrong_notification_is_refused(tmp_path: Path, section: str, words: str) -> None:
    for folder in ("sequences", "stations"):
        (tmp_path / folder).mkdir()
    station = (ROOT / "stations" / "af_bench_sim.yaml").read_text()
    (tmp_path / "stations" / "af_bench_sim.yaml").write_text(f"{station}\nnotify:\n{section}\n")
    path = tmp_path / "sequences" / "sample.yaml"
    path.write_text(SEQUENCE)
    with pytest.raises(InputErrors) as caught:
        compile_sequence(path, None, {})
    assert words in str(caught.value)


def test_a_sequence_may_ask_for_early_verdicts(tmp_path: Path) -> None:
    plan = compiled(tmp_path, "early: {after: 30 min, every: 2 h, on_fail: hold, max_lost: 0.5 %}\n")
    assert plan.early is not None
    assert (plan.early.after, plan.early.every, plan.early.on_fail) == (1800.0, 7200.0, "hold")
    assert plan.early.max_lost == 0.005


def test_a_plan_that_no_interlock_watches_says_so(tmp_path: Path) -> None:
    station = (ROOT / "stations" / "af_bench_sim.yaml").read_text(encoding="utf-8")
    before, _, behind = station.partition("interlocks:\n")
    bare = tmp_path / "bare.yaml"
    bare.write_text(before + behind[behind.index("# What the live page draws") :], encoding="utf-8")
    disk = tmp_path / "disk.yaml"
    only = "interlocks:\n  disk: {signal: disk_time, low: 1 h, action: hold}\n"
    disk.write_text(before + only + behind[behind.index("# What the live page draws") :], encoding="utf-8")
    sequence = find_shipped("sequences", "scale_factor_short")
    assert "no interlock is declared" in unwatched(compile_sequence(sequence, load_station(bare), {}))[0]
    assert "no interlock watches the chamber" in unwatched(compile_sequence(sequence, load_station(disk), {}))[0]
    watched = compile_sequence(sequence, None, {})
    assert unwatched(watched) == summarise(watched).unwatched == ()
