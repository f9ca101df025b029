"""Where the tests at the FMI boundary find the modules that they share."""

from __future__ import annotations

import sys
from pathlib import Path

TESTS = Path(__file__).parents[1]
# pytest imports tests without their folder
sys.path[:0] = [str(TESTS), str(TESTS / "fmu_boundary"), str(TESTS / "cosim" / "exchange" / "fmu_export")]
