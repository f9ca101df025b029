"""JSON for files and standard output."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def to_json(data: Mapping[str, Any]) -> str:
    """JSON text that ends with a line break; refuses NaN and infinity, which JSON doesn't know."""
    return json.dumps(data, ensure_ascii=False, indent=2, allow_nan=False) + "\n"
