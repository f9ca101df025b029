"""Tests of control import the plant of `axis_slave` beside this file."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder
