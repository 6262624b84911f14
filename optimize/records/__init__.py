"""What runs have left behind in a folder, read from their own records, as a list and as a page."""

from optimize.records.find_runs import find_runs
from optimize.records.run_record import KINDS, STATES, RunRecord
from optimize.records.runs_page import (
    degrees_text,
    record_to_json,
    score_text,
    when_text,
    write_runs_page,
)
