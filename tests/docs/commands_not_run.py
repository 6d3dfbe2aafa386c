"""Commands of the pages that no test of the pages runs, each with its reason; they are still parsed.

A key is the beginning of a command line as a page has it. The list gets no longer: what a page newly shows runs.
"""

_LIVING = "talks to a living run; tests/runs/test_cli_status.py does that"
_SERVES = "serves until it is stopped; tests/browser and tests/runs do that"
_REAL = "needs instruments"
_OTHERS = "needs the recording of other people; tests marked 'real' have it"

NOT_RUN = {
    "bench abort ": _LIVING,
    "bench answer ": _LIVING,
    "bench pause ": _LIVING,
    "bench resume ": _LIVING,
    "bench top": _LIVING,
    "bench serve": _SERVES,
    "bench sim ": _SERVES,
    "bench drill ": "kills a controller on a served bench in real time; tests/runs and tests/fault do that",
    "bench run scale_factor_wall_30s ": "needs a served bench, in real time",
    "bench commission ": _REAL,
    "bench check scale_factor_38h --station my_bench ": _REAL,
    "bench run scale_factor_38h --station my_bench ": _REAL,
    "bench certificate sessions/2026": "needs a session of real instruments and a schema that is not shipped",
    "bench certificate SESSION --laboratory ": "needs a session of real instruments",
    "bench import docs/mappings/tckit_1v_ramp.yaml ": _OTHERS,
    "bench fit sessions/20241020T011845Z_": _OTHERS,
    "bench study ": "takes minutes; tests/systems/time_sync does a small one",
    "bench recover SESSION --make-up ": "needs a damaged session; tests/runs/test_campaign_salvage.py has one",
    "bench run rest.yaml": "needs a damaged session; tests/runs/test_campaign_salvage.py has one",
    "bench fit SESSION --with ": "needs a damaged session; tests/runs/test_campaign_salvage.py has one",
    "bench fit SESSION --accept ": "needs a doubtful estimate; tests of acceptances have one",
    "bench fit SESSION --method as_printed": "needs a campaign of dmm_method; tests/systems/af_converter have one",
    "bench fit SESSION --method joint_unit_sensor": "needs a bias campaign; tests/systems/af_converter have one",
    "bench coefficients ": "needs two campaigns of one unit; tests/systems/af_converter have them",
    "bench history compare SESSION SESSION": "needs two calibrations; tests/runs/archive has them",
    "bench fit $S/": "ends with a move of files into the repository",
}
MOST_PARSED = 35  # command lines of all pages
MOST_CHECKED = 23  # long runs, whose plans are compiled and checked instead; tests/runs and tests/systems run them
