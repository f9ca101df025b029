"""What tests of everything use: how much work something is, counted instead of timed."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable

import pytest


@pytest.fixture
def count_calls() -> Callable[[Callable[[], object]], int]:
    """Counts the functions that an action calls, those of Python and those of C."""

    def counted(action: Callable[[], object]) -> int:
        count = 0

        def profile(frame: object, event: str, argument: object) -> None:
            nonlocal count
            count += event in ("call", "c_call")

        before = sys.getprofile()
        gc.collect()
        gc.disable()  # what other tests have left must not be finalised, and counted, here
        sys.setprofile(profile)
        try:
            action()
        finally:
            sys.setprofile(before)
            gc.enable()
        return count - 2  # the action itself, and the end of counting

    return counted
