"""What the paper does not state and is assumed here, and what cannot be matched, with the reason."""

from __future__ import annotations

QUICK = (
    "A quick study, or one of fewer than 50 runs: the tolerances are stated for 50 runs and the flight of 500 s, so "
    "that nothing but the case without errors is judged."
)
NOTES = (
    "Errors are estimate minus truth. T_d > 0 means that the EGI sample is old: tagged t, true at t - T_d.",
    "An uncompensated offset adds to the mean error; the tables print root mean squares, sqrt(RMS0^2 + (v T_d)^2) "
    "where the mean is zero. That of 50 runs is not: Table 5 is held against sqrt(RMS0^2 - 2 m0 v T_d + (v T_d)^2) "
    "with the mean m0 of the same runs at 0 ms, and the ratio to the shorter formula stands beside it.",
    "Standard uncertainties are those of a finite number of runs. Ratios and paired differences use the same runs.",
)
ASSUMED = (
    ("Frame and Earth", "local tangent plane at latitude 37.5 deg, point-mass gravity gradient, constant Earth rate"),
    (
        "EGI",
        "an INS/GPS filter of its own with Table 1, GPS once a second, 60 s of straight flight before: its errors are "
        "coloured, not white",
    ),
    ("Initial yaw of the EGI", "0.003 deg/h over the horizontal Earth rate: 0.0144 deg"),
    ("Units of Tables 1 and 2", "velocity random walk in ug per root hertz, angle random walk in deg per root hour"),
    (
        "Measurement noise R",
        "base 1 m, 0.2 m/s, 0.01 deg (Tables 5 to 7, figures 3, 4, 5a, 6a, 15, 16); tight 1 m, 0.05 m/s, 0.01 deg "
        "(biases, images); loose 10 m, 2 m/s, 0.05 deg (figure 11)",
    ),
    (
        "P0",
        "position 1 m (figures 3 to 7, Tables 5 to 7) or 10 m wherever T_d is a state, so that p - v T_d does not pass "
        "for knowledge of T_d; velocity 0.1 m/s; attitude 0.05 deg; biases of Table 2; T_d 30 ms",
    ),
    ("Initial state", "the first EGI sample, with its errors and the lag of T_d; never the truth"),
    ("Clock noise", "10 us white on every EGI tag, which section 2.1.1 of the paper names"),
    (
        "Different rates, figure 1 (a)",
        "cured by propagation: the prediction is interpolated in the solution of the IMU at t - T_d, at any fraction "
        "of a sample",
    ),
    ("Turns", "flat, without bank; 4.5 deg/s at 100 m/s, and 9 deg/s at 250 m/s, which is 4.0 g sideways, as stated"),
    (
        "Statistics",
        "Table 5: RMS over runs and t > 5 s; Tables 6 and 7: greatest RMS over runs; biases: RMS over runs and 20-40 s",
    ),
    (
        "Radar",
        "9.6 GHz, broadside to the right, 3 km high, 45 km slant range, no weighting, point targets of constant "
        "amplitude, stop-and-go",
    ),
    (
        "Aperture policy, in place of PEM",
        "while the radar is on, position and velocity updates are held and attitude updates go on; updates within the "
        "aperture would destroy the image",
    ),
    (
        "Windows",
        "PSLR and ISLR: main lobe to the first zeros of the ideal response (1.13 cells), side lobes from there to 12 "
        "cells, the same for every image; grid 0.05 cell",
    ),
)
MISPRINTS = (
    ("(1)-(3)", "plus signs", "dp_T = dp - v T_d and alike, with estimate minus truth"),
    ("(6)", "left side dx'", "d/dt dx'"),
    (
        "(7), (9)",
        "measurement at t - estimate of T_d",
        "the measurement is at t - T_d; what is printed is its prediction",
    ),
    ("(8), (10)", "two signs of the innovation", "dz_p = dp - v dT_d; dz_v = dv - a dT_d; dz_phi = dphi - w dT_d"),
    (
        "(11)",
        "difference of velocities",
        "both corrected before the difference, else the update passes for acceleration",
    ),
    ("(12)", "any attitude error", "right-handed rotation vector in t; w without the Earth's rate"),
    ("(13)", "layout lost", "H' = [ H | h ], h = [ -v ; -a ; -w ]"),
)
UNMATCHED = (
    ("Rows of 0 ms", "the EGI's own errors set them, and its filter is not described"),
    (
        "Table 6, growth 1.4 times a T_d",
        "the printed values grow 1.41 to 1.47 times as fast as equation (2) says; statistic and tuning are not stated",
    ),
    ("y axes of figures 3 to 16", "the text of the paper has no axes; R, P0, order and weights of PEM are not given"),
    (
        "Figures 8 to 10, 12 to 14",
        "carrier, squint, height and target are not given: shifts are compared with v T_d and with the errors of "
        "each run itself",
    ),
    (
        "Figure 16 as RMS over 60 s",
        "most of it comes from the 20 s before the manoeuvre; the curve over time tells more, and so does P'_TdTd",
    ),
    ("A shift of v T_d", "it is some 9 % more: the offset also leaves a velocity error along the line of sight"),
)
