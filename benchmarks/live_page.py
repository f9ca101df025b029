"""How long a slider of a report that simulates takes to redraw, in headless Chromium, from file://: `python benchmarks/live_page.py`.

Two pages, the robot alone and a PD loop at 1 kHz; 60 moves each of the first slider. Needs Chromium, playwright and ziglang.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from playwright.sync_api import sync_playwright

import flexfmu

MOVES = """async () => {
  const found = [], { input } = page.live.sliders[0];
  for (let i = 0; i < 60; i++) {
    const before = page.updates ?? 0;
    input.value = -0.9 + 0.03 * i;
    input.dispatchEvent(new Event("input"));
    while ((page.updates ?? 0) === before) await new Promise((next) => requestAnimationFrame(next));
    found.push(page.redrawn);
  }
  return found.sort((a, b) => a - b);
}"""
ARGUMENTS = ["--headless", "--no-sandbox", "--disable-gpu"]
LIMITS = {"robot alone": 50.0, "PD loop at 1 kHz": 150.0}
"""Times within which 95 % of the moves are wanted [ms]."""


def main() -> None:
    """Print a line for each page."""
    robot = flexfmu.load_scene("barnard2012-6kg")
    loop = robot.replace({"cosimulation.drive": "torque", "cosimulation.step": 1e-3, "effects.motor_inertia": 0.1})
    pd = {"kind": "pd", "proportional": 1e4, "derivative": 100.0, "sample_time": 1e-3}
    runs = dict(zip(LIMITS, (flexfmu.run(robot), flexfmu.run(loop.replace({"controller": [pd]}))), strict=True))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=ARGUMENTS)
        for name, run in runs.items():
            path = run.live_report(Path(folder) / "page.html")
            page, problems = browser.new_page(viewport={"width": 1400, "height": 1000}), list[str]()
            page.on("console", lambda message, found=problems: found.append(message.text))
            page.goto(f"file://{path}")
            page.locator("#live.ready").wait_for()
            times = page.evaluate(MOVES)
            middle, high = times[len(times) // 2], times[int(0.95 * len(times))]
            print(
                f"{name}: {path.stat().st_size / 1000:.0f} kB, a move redraws in {middle:.0f} ms, 95 % within {high:.0f} ms "
                f"(wanted: {LIMITS[name]:.0f} ms), {len(problems)} messages on the console"
            )
            page.close()
        browser.close()


if __name__ == "__main__":
    main()
