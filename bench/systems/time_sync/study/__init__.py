"""The published Monte Carlo study, computed again beside ours."""

from bench.systems.time_sync.study.document import results_of as results_of
from bench.systems.time_sync.study.document import study_chapters as study_chapters
from bench.systems.time_sync.study.document import study_document as study_document
from bench.systems.time_sync.study.document import study_json as study_json
from bench.systems.time_sync.study.study import checked_options as checked_options
from bench.systems.time_sync.study.study import tasks_of as tasks_of
from bench.systems.time_sync.study.tasks import run_task as run_task
