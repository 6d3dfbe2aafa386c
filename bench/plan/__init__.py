"""Floor 2: sequence and station files, the compiled plan, and its static check."""

from bench.plan.check import check_plan as check_plan
from bench.plan.compile import compile_sequence as compile_sequence
from bench.plan.plan import Plan as Plan
from bench.plan.plan import Step as Step
from bench.plan.schemas import json_schemas as json_schemas
from bench.plan.schemas import vscode_settings as vscode_settings
from bench.plan.station import Station as Station
from bench.plan.station import load_station as load_station
from bench.plan.summary import Summary as Summary
from bench.plan.summary import summarise as summarise
