"""Floor 2: sequence and station files, the compiled plan, and its static check."""

from bench.plan.check import check_plan as check_plan
from bench.plan.compile import compile_sequence as compile_sequence
from bench.plan.plan import Plan as Plan
from bench.plan.plan import SetPoint as SetPoint
from bench.plan.plan import Step as Step
from bench.plan.station import Station as Station
from bench.plan.station import load_station as load_station
from bench.plan.step_kinds import CHAMBER as CHAMBER
from bench.plan.step_kinds import MEASUREMENT as MEASUREMENT
from bench.plan.step_kinds import WIRING as WIRING
from bench.plan.step_kinds import PlannedCall as PlannedCall
from bench.plan.step_kinds import PlannedCommand as PlannedCommand
from bench.plan.step_kinds import PlannedPrompt as PlannedPrompt
from bench.plan.step_kinds import PlannedRecord as PlannedRecord
from bench.plan.step_kinds import PlannedSend as PlannedSend
from bench.plan.step_kinds import PlannedSettle as PlannedSettle
from bench.plan.step_kinds import PlannedSoak as PlannedSoak
from bench.plan.step_kinds import PlannedVerify as PlannedVerify
from bench.plan.step_kinds import plan_json as plan_json
from bench.plan.step_kinds import step_of as step_of
from bench.plan.step_kinds import steps_of as steps_of
