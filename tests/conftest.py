"""What tests of everything use: one cache of FMUs, drawn cases that are the same on every machine, tools that must not be missing
where they can be had, what was left out, and how much work something is, counted instead of timed."""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pytest
import scipy.linalg  # noqa: F401 - a limit holds for libraries that are loaded
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

# a shell's background job ignores Ctrl-C, and what its tests start would too
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# threads of BLAS, which wait for each other on a busy machine, take several times the processor time of one
threadpool_limits(1, user_api="blas")

sys.path.insert(0, str(Path(__file__).parent))  # pytest imports tests without their folder: `formulations`, for example

# a test that fails does so by a change, not by the draw or because the machine is busy
settings.register_profile(
    "flexfmu",
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.load_profile("flexfmu")

# tests run in parallel have the width of a terminal, and commands in a pipe take it
os.environ.pop("COLUMNS", None)

TOOLS_REQUIRED = os.environ.get("FLEXFMU_REQUIRE_TOOLS", "0") not in ("", "0")
"""Whether a test that misses a tool fails instead of being skipped; `.ci/run` sets the variable where `.ci/tools` gets them."""

NO_TOOL_HELPS = re.compile(
    "ELF|on Linux|POSIX|this system has no|root may|the reference is linux64|builds for .* here|source tree"
    "|OMSimulator"  # its package fetches binaries from a server of its own while it is installed
)
"""In the reasons of tests that are skipped for another cause than a missing tool."""


Report = TypeVar("Report", pytest.TestReport, pytest.CollectReport)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Where tools are required a skipped test fails, unless no tool would help."""
    return _required((yield))


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """The same for whole files."""
    return _required((yield))


def _required(report: Report) -> Report:
    is_expected = hasattr(report, "wasxfail")
    if TOOLS_REQUIRED and report.skipped and not is_expected and not NO_TOOL_HELPS.search(report.longreprtext):
        report.outcome = "failed"
        report.longrepr = f"{report.longreprtext}: FLEXFMU_REQUIRE_TOOLS asks for every tool; .ci/tools gets them"
    return report


LEFT_OUT = pytest.StashKey[int]()
"""How many slow tests the selection leaves out."""


def pytest_deselected(items: Sequence[pytest.Item]) -> None:
    """Count slow tests among them."""
    for item in items:
        item.config.stash[LEFT_OUT] = item.config.stash.get(LEFT_OUT, 0) + (item.get_closest_marker("slow") is not None)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A process of pytest-xdist tells the first one."""
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["left_out"] = session.config.stash.get(LEFT_OUT, 0)


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any) -> None:
    """All of its processes have the same selection."""
    node.config.stash[LEFT_OUT] = getattr(node, "workeroutput", {}).get("left_out", 0)


def pytest_unconfigure(config: pytest.Config) -> None:
    """The last line says what is missing, and how to run it."""
    if config.stash.get(LEFT_OUT, 0) and not hasattr(config, "workeroutput"):
        kinds = "examples, tutorials, other people's tools, whole studies, every variant"
        print(f"left out: {config.stash[LEFT_OUT]} slow tests ({kinds}); `make test-all` runs them too")


@pytest.fixture(scope="session", autouse=True)
def shared_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The cache of all tests, processes that they start included: no test writes into the user's own, and no FMU is built twice, also by
    several runs of pytest that share FLEXFMU_TEST_CACHE."""
    folder = tmp_path_factory.getbasetemp()
    # pytest-xdist gives each of its processes a folder of its own within that of the session
    folder = (folder.parent if "PYTEST_XDIST_WORKER" in os.environ else folder) / "cache"
    folder = Path(os.environ.get("FLEXFMU_TEST_CACHE", folder))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FLEXFMU_CACHE", str(folder))
        yield folder


CHROMIUM = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
"""How Chromium is started: without a screen and a network."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """One Chromium for all tests of a module: while it runs no other event loop can."""
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("needs chromium")
    with pytest.importorskip("playwright.sync_api").sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=CHROMIUM)
        yield browser
        browser.close()


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
