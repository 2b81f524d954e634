"""Time of compiling the loops of each search from nothing, in a process and a cache of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import os
import tempfile
import time
from typing import Any
from unittest.mock import patch

from track_before_detect.evaluation.benchmarks.bench import Bench
from track_before_detect.evaluation.benchmarks.own_process import in_own_process
from track_before_detect.evaluation.benchmarks.timing import in_ms, summary
from track_before_detect.evaluation.engine.tables import aligned
