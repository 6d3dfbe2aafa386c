"""Floor 2: sequence and station files, the compiled plan, and its static check."""

from bench.plan.check import check_plan as check_plan
from bench.plan.compile import compile_sequence as compile_sequence
from bench.plan.plan import Plan as Plan
from bench.plan.plan import Step as Step
from bench.plan.station import Station as Station
from bench.plan.station import load_station as load_station
