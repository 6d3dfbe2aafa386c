"""The published Monte Carlo study, computed again beside ours."""

from bench.systems.time_sync.study.document import results_of, study_chapters, study_document, study_json
from bench.systems.time_sync.study.study import checked_options, tasks_of
from bench.systems.time_sync.study.tasks import run_task
