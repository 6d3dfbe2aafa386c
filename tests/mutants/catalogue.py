"""Mistakes that must not pass: each is put into a copy of the product, and the tests named for it must fail.

The tests of a mutant take a few seconds at most; that others catch it too does not matter here.
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple


class Mutant(NamedTuple):
    """A mistake: in a file, ``old`` (which stands there once) becomes ``new``; ``tests`` are those that notice it."""

    name: str
    file: str
    old: str
    new: str
    tests: list[str]


MUTANTS = [
    Mutant(
        "sign of the pulses of the other polarity",
        "bench/systems/af_converter/estimators/scale_factor.py",
        "np.column_stack([n_A, -p_A, rows.polarity > 0",
        "np.column_stack([n_A, p_A, rows.polarity > 0",
        ["tests/unit/systems/af_converter/test_scale_factor.py::test_ideal_rows_are_recovered_exactly_by_every_method"],
    ),
    Mutant(
        "counted current added to the reference",
        "bench/systems/af_converter/estimators/scale_factor.py",
        "reference_A - (n_A - p_A) - response_A_degC",
        "reference_A - (n_A + p_A) - response_A_degC",
        ["tests/unit/systems/af_converter/test_scale_factor.py::test_ideal_rows_are_recovered_exactly_by_every_method"],
    ),
    Mutant(
        "calibrator gain with the wrong sign",
        "bench/systems/af_converter/estimators/scale_factor.py",
        "rows.level_A * (1.0 + gain)",
        "rows.level_A * (1.0 - gain)",
        ["tests/unit/systems/af_converter/test_scale_factor.py::test_corrections_of_the_certificate_are_applied"],
    ),
    Mutant(
        "common gain left out of the uncertainty",
        "bench/systems/af_converter/estimators/scale_factor.py",
        "to_ppm @ (reference_A * relative)",
        "to_ppm @ (reference_A * relative * 0.0)",
        [
            "tests/unit/systems/af_converter/test_scale_factor.py::test_gain_is_ten_ppm_on_both_and_cancels_in_the_asymmetry"
        ],
    ),
    Mutant(
        "clock ratio upside down",
        "bench/systems/af_converter/estimators/readings.py",
        "af_clock_Hz * gate_s / counted",
        "counted / (af_clock_Hz * gate_s)",
        ["tests/unit/systems/af_converter/test_mutations.py::test_positive_zero_used_as_negative_zero"],
    ),
    Mutant(
        "error of the master clock with the wrong sign",
        "bench/systems/af_converter/estimators/readings.py",
        "fg_Hz * gate_s / counted - 1.0",
        "1.0 - fg_Hz * gate_s / counted",
        ["tests/unit/systems/af_converter/test_oscillator.py::test_residual_and_interval"],
    ),
    Mutant(
        "bias with the sign of the reading",
        "bench/systems/af_converter/estimators/readings.py",
        "value_A=-float(np.mean(reading_A))",
        "value_A=float(np.mean(reading_A))",
        ["tests/unit/systems/af_converter/test_mutations.py::test_bias_sign_flipped"],
    ),
    Mutant(
        "polynomial about 0 degC",
        "bench/systems/af_converter/estimators/temperature.py",
        "np.vander(temperature_degC - reference_degC, degree",
        "np.vander(temperature_degC, degree",
        ["tests/unit/systems/af_converter/test_temperature.py::test_groups_without_temperatures_are_refused_by_name"],
    ),
    Mutant(
        "play operator turned round",
        "bench/systems/af_converter/estimators/hysteresis/model.py",
        "np.maximum(held, low), np.minimum(held, high)",
        "np.minimum(held, high), np.maximum(held, low)",
        ["tests/unit/systems/af_converter/test_hysteresis_parts.py::test_play_by_hand"],
    ),
    Mutant(
        "play followed through the whole cell",
        "bench/systems/af_converter/estimators/hysteresis/model.py",
        "moved * share / 2.0",
        "moved / 2.0",
        ["tests/unit/systems/af_converter/test_hysteresis_parts.py::test_mean_of_the_play_in_a_cell_is_exact"],
    ),
    Mutant(
        "branches of the hysteresis exchanged",
        "bench/systems/af_converter/estimators/hysteresis/model.py",
        "behind -= (on_grid[:-1] + on_grid[1:]) / 2.0",
        "behind = (on_grid[:-1] + on_grid[1:]) / 2.0 - behind",
        ["tests/unit/systems/af_converter/test_fit_hysteresis.py::test_truth_over_twenty_seeds"],
    ),
    Mutant(
        "unit that runs ahead of the chamber",
        "bench/systems/af_converter/estimators/gates.py",
        "mean - lag_s * np.diff(unit_degC)",
        "mean + lag_s * np.diff(unit_degC)",
        ["tests/unit/systems/af_converter/test_hysteresis_parts.py::test_lag_and_its_means_against_an_integrator"],
    ),
    Mutant(
        "quantisation that does not telescope",
        "bench/systems/af_converter/estimators/gates.py",
        "beside = -edge[1:] * edge[:-1] * linked",
        "beside = edge[1:] * edge[:-1] * linked",
        ["tests/unit/systems/af_converter/test_fit_gates.py::test_whitening_is_that_of_the_dense_cholesky_factor"],
    ),
    Mutant(
        "random walk of the mean of a gate",
        "bench/systems/af_converter/estimators/gates.py",
        "_WALK = {False: 1.0 / 3.0",
        "_WALK = {False: 1.0 / 2.0",
        ["tests/unit/systems/af_converter/test_fit_gates.py::test_whitening_is_that_of_the_dense_cholesky_factor"],
    ),
    Mutant(
        "gated count of the other polarity added",
        "bench/systems/af_converter/estimators/record_rate.py",
        "np.asarray(converters.k_n_C) * n - np.asarray(converters.k_p_C) * p",
        "np.asarray(converters.k_n_C) * n + np.asarray(converters.k_p_C) * p",
        ["tests/unit/systems/af_converter/test_record_rate.py::test_each_polarity_has_its_own_charge"],
    ),
    Mutant(
        "weights of the slope one frame off",
        "bench/systems/af_converter/estimators/record_rate.py",
        "(n + 1) * pulses.moment1 - pulses.moment2",
        "n * pulses.moment1 - pulses.moment2",
        [
            "tests/unit/systems/af_converter/test_record_rate.py::test_the_slope_is_that_of_a_line_fitted_to_the_cumulative_counts"
        ],
    ),
    Mutant(
        "guard band that widens the limit",
        "bench/maths/verdict.py",
        "guard = 0.0 if rule == SIMPLE else expanded_uncertainty",
        "guard = 0.0 if rule == SIMPLE else -expanded_uncertainty",
        ["tests/unit/maths/test_verdicts.py::test_what_compensation_leaves_over_is_judged"],
    ),
    Mutant(
        "risk of the other statement",
        "bench/maths/verdict.py",
        "1.0 - inside if meaning_of(statement).accepts else inside",
        "inside if meaning_of(statement).accepts else 1.0 - inside",
        ["tests/unit/maths/test_verdicts.py::test_risk_at_the_edges_of_the_rules"],
    ),
    Mutant(
        "drift of the calibrator with the sign of the unit",
        "bench/systems/af_converter/scale_factor/calibrator_drift.py",
        "mean = np.array([-0.5, -0.5])",
        "mean = np.array([0.5, 0.5])",
        [
            "tests/unit/systems/af_converter/test_calibrator_drift.py::test_closing_repeat_that_shows_a_change_is_carried_on_to_the_whole_campaign"
        ],
    ),
    Mutant(
        "drift by the meter turned round",
        "bench/systems/af_converter/scale_factor/calibrator_drift.py",
        "_PPM * (last.mean_A - first.mean_A)",
        "_PPM * (first.mean_A - last.mean_A)",
        [
            "tests/unit/systems/af_converter/test_calibrator_drift.py::test_two_ppm_are_seen_by_the_meter_and_become_the_component"
        ],
    ),
    Mutant(
        "cross coupling in the place of its transpose",
        "bench/systems/gnc/estimators/triad.py",
        "matrix = solution[:3].T",
        "matrix = solution[:3]",
        ["tests/unit/systems/gnc/test_imu_six_position.py::test_fifty_units_within_50_ppm"],
    ),
    Mutant(
        "Allan difference of neighbours",
        "bench/maths/allan.py",
        "- 2.0 * angle[factor:-factor] + angle",
        "- angle[factor:-factor] + 0.0 * angle",
        ["tests/unit/maths/test_allan.py::test_nbs_14_point_suite"],
    ),
    Mutant(
        "confidence limits of the Allan deviation exchanged",
        "bench/maths/allan.py",
        "tail = (1.0 - probability) / 2.0",
        "tail = (1.0 + probability) / 2.0",
        ["tests/unit/maths/test_allan.py::test_confidence_limits_are_those_of_chi_squared"],
    ),
    Mutant(
        "quadrant of north by the other lock-in",
        "bench/systems/north/estimators/formulas.py",
        "1j * (big_1 - big_2 * np.sin(apart))",
        "1j * (big_1 + big_2 * np.sin(apart))",
        ["tests/unit/systems/north/test_formulas.py::test_misplaced_pulses_are_calibrated"],
    ),
    Mutant(
        "quadrant that nobody knows is told",
        "bench/systems/north/estimators/formulas.py",
        "np.abs(apart_deg) < LARGEST_deg",
        "np.abs(apart_deg) < 2.0 * LARGEST_deg",
        ["tests/unit/systems/north/test_formulas.py::test_pulses_near_or_beyond_ninety_degrees"],
    ),
    Mutant(
        "lock-in error put on twice",
        "bench/systems/lock_in/estimators/random_walk.py",
        "step = step - jumps.dpsi_rad",
        "step = step + jumps.dpsi_rad",
        ["tests/unit/systems/lock_in/test_compensators.py::test_a_dither_that_slides_against_the_clock"],
    ),
    Mutant(
        "parabolas against their order in time",
        "bench/systems/lock_in/estimators/single_turnarounds.py",
        "at_behind - at_before,",
        "at_before - at_behind,",
        ["tests/unit/systems/lock_in/test_compensators.py::test_backscatter_at_90_degrees"],
    ),
    Mutant(
        "sample of the time before taken for later",
        "bench/systems/time_sync/estimators/kalman/innovation.py",
        "return t_s - offset_s",
        "return t_s + offset_s",
        [
            "tests/unit/systems/time_sync/test_filter.py::test_late_early_and_fractional_offsets_are_found_with_their_sign"
        ],
    ),
    Mutant(
        "time offset fed back with the wrong sign",
        "bench/systems/time_sync/estimators/kalman/filter.py",
        "self._offset_s -= dx[OFFSET]",
        "self._offset_s += dx[OFFSET]",
        [
            "tests/unit/systems/time_sync/test_filter.py::test_late_early_and_fractional_offsets_are_found_with_their_sign"
        ],
    ),
    Mutant(
        "Earth that turns the other way",
        "bench/maths/strapdown.py",
        "small_rotation(-self._rate * interval_s)",
        "small_rotation(self._rate * interval_s)",
        ["tests/unit/maths/test_strapdown.py::test_free_of_noise_the_flight_comes_back_within_a_millimetre"],
    ),
    Mutant(
        "verdict of the signed value",
        "bench/maths/verdict.py",
        "(-limit, limit)",
        "(-math.inf, limit)",
        ["tests/unit/maths/test_verdicts.py::test_guard_band_of_the_design"],
    ),
    Mutant(
        "centre of the magnetometer with the wrong sign",
        "bench/systems/gnc/estimators/magnetometer/quadric.py",
        "centre=middle + scale * centre",
        "centre=middle - scale * centre",
        ["tests/unit/systems/gnc/test_ellipse.py::test_published_best_fit"],
    ),
    Mutant(
        "temperature response of the other polarity",
        "bench/systems/af_converter/estimators/scale_factor.py",
        "slope_n * n_A - slope_p * p_A",
        "slope_n * n_A + slope_p * p_A",
        [
            "tests/unit/systems/af_converter/test_fit_campaign.py::test_rows_of_a_warming_unit_are_referred_to_one_temperature"
        ],
    ),
    Mutant(
        "CRC without its last exclusive or",
        "bench/frame/crc.py",
        "return state ^ model.xorout\n",
        "return state\n",
        ["tests/unit/frame/test_crc.py::test_published_check_value_single_and_vectorised"],
    ),
    Mutant(
        "CRC with the wrong bit carried",
        "bench/frame/crc.py",
        "(byte >> 1) ^ (poly if byte & 1 else 0)",
        "(byte >> 1) ^ (poly if byte & 2 else 0)",
        ["tests/unit/frame/test_crc.py::test_published_check_value_single_and_vectorised"],
    ),
    Mutant(
        "lost frames not counted",
        "bench/frame/counter.py",
        "int(steps.sum() - new.sum())",
        "int(steps.sum() - steps.sum())",
        ["tests/unit/frame/test_counter.py::test_lost_frames_inside_and_between_batches"],
    ),
    Mutant(
        "record that begins one frame late",
        "bench/record/window.py",
        "return self.window.first_counter + self.window.frames",
        "return self.window.first_counter + self.window.frames + 1",
        ["tests/unit/record/test_cut.py::test_sums_of_whole_records_are_exact"],
    ),
    Mutant(
        "journal line that proves no place",
        "bench/record/journal.py",
        "zlib.crc32(text, self._lines + 1)",
        "zlib.crc32(text, 1)",
        ["tests/unit/record/test_journal.py::test_what_was_written_is_read"],
    ),
    Mutant(
        "torn line of the journal left standing",
        "bench/record/journal.py",
        "            if before.torn:\n                self._file.truncate(self._size)",
        "            if before.torn:\n                pass",
        ["tests/unit/record/test_journal.py::test_reopened_journal_goes_on_behind_its_good_part"],
    ),
    Mutant(
        "gap of more than a wrap taken for a short one",
        "bench/frame/counter.py",
        "turns = np.rint((expected - step) / self._wrap)",
        "turns = np.rint(0.0 * (expected - step))",
        ["tests/unit/frame/test_counter.py::test_gaps_longer_than_a_wrap_by_receive_time"],
    ),
    Mutant(
        "safe state tried once",
        "bench/run/bench/safety.py",
        "ATTEMPTS = 3",
        "ATTEMPTS = 1",
        ["tests/unit/run/test_sequencer.py::test_an_error_in_a_step_makes_everything_safe_in_order_even_if_one_fails"],
    ),
    Mutant(
        "safe state in any order",
        "bench/run/bench/safety.py",
        "first = [role for role in order if role in instruments]",
        "first = [role for role in instruments if role not in order]",
        ["tests/unit/run/test_sequencer.py::test_an_error_in_a_step_makes_everything_safe_in_order_even_if_one_fails"],
    ),
    Mutant(
        "command under a new number at each attempt",
        "bench/run/steps/exchange.py",
        "reader.write(frame)\n        answer = _awaited",
        "reader.write(reader.command(arguments, number + attempts))\n        answer = _awaited",
        ["tests/unit/run/steps/test_exchange.py::test_a_test_is_noted_with_everything_that_was_sent_and_received"],
    ),
    Mutant(
        "guard that waits twice its deadline",
        "bench/run/guard/decision.py",
        "silent_s >= state.silence_s",
        "silent_s >= 2 * state.silence_s",
        ["tests/unit/run/guard/test_guard_decision.py::test_silence_counts_from_its_limit_on"],
    ),
    Mutant(
        "hard limit that may be reached",
        "bench/run/guard/decision.py",
        "value >= limit",
        "value > limit",
        ["tests/unit/run/guard/test_guard_decision.py::test_a_limit_is_crossed_where_it_is_reached"],
    ),
    Mutant(
        "interlock that trips without its dwell",
        "bench/run/watch/interlocks.py",
        "t_ns - self._beyond_ns >= self.rule.dwell_s * NS else None",
        "t_ns >= self._beyond_ns else None",
        ["tests/unit/run/watch/test_interlocks.py::test_it_trips_when_the_dwell_is_over_and_not_before"],
    ),
    Mutant(
        "page that asks nobody for a login",
        "bench/web/security/gate.py",
        "if not is_login:",
        "if is_login:",
        ["tests/unit/web/test_gate.py::test_every_route_without_a_login_is_401"],
    ),
    Mutant(
        "record with losses taken as it is",
        "bench/run/steps/recording.py",
        "if lost / due <= step.max_lost or attempt == attempts - 1:",
        "if lost / due >= step.max_lost or attempt == attempts - 1:",
        ["tests/unit/run/steps/test_recording.py::test_lost_frames_take_the_record_again"],
    ),
    Mutant(
        "soak that is never late",
        "bench/run/steps/soak.py",
        "        if not _is_stable(found):\n            found = _late",
        "        if found[0][1] is None:\n            found = _late",
        ["tests/runs/test_campaign_faults.py::test_a_chamber_that_never_settles_is_held_for_and_then_given_up"],
    ),
    Mutant(
        "retry that sends a set-point again",
        "instruments/bus.py",
        "if not repeatable or self.climb is None",
        "if self.climb is None",
        ["tests/protocol/test_ladder.py::test_a_command_in_doubt_that_took_effect_is_not_sent_again"],
    ),
]

# Evidence that is not heard, as if its threshold were never reached; evidence.csv: the test that then finds too little.
MUTANTS += [
    Mutant(
        f"evidence {row['code']} is not heard",
        "bench/analysis/doubt.py",
        "    heard = list(evidence)\n",
        f"    heard = [seen for seen in evidence if seen.code != {row['code']!r}]\n",
        [row["test"]],
    )
    for row in csv.DictReader(Path(__file__).with_name("evidence.csv").read_text(encoding="utf-8").splitlines())
]
