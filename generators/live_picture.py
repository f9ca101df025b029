"""Draws docs/live.webp, the report of the 6 kg scene while its payload changes: `python generators/live_picture.py`.

Needs Chromium, playwright and ziglang; Matplotlib brings Pillow along.
"""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

import flexfmu

TARGET = Path(__file__).parents[1] / "docs" / "live.webp"
SIZE, WIDTH = {"width": 1240, "height": 1180}, 900
"""Of the window, and width of the picture [px]."""

PLACES = [0.0, *(-0.05 * k for k in range(1, 13)), -0.6]
"""Of the slider: from 6 kg to half of it."""

FRAME, LAST = 220, 2500
"""How long a picture is shown, and the last one [ms]."""


def main() -> None:
    """Write the picture."""
    pictures = []
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        path = flexfmu.run("barnard2012-6kg").live_report(Path(folder) / "page.html")
        arguments = ["--headless", "--no-sandbox", "--disable-gpu"]
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=arguments)
        page = browser.new_page(viewport=SIZE)
        page.goto(f"file://{path}")
        page.locator("#live.ready").wait_for()
        page.evaluate("window.scrollTo(0, 170)")
        for number, place in enumerate(PLACES):
            page.get_by_role("slider", name="payload.mass").fill(str(place))
            page.evaluate(f"page.at({0.05 + 0.35 * number / len(PLACES)})")
            page.wait_for_timeout(900.0)
            whole = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
            pictures.append(whole.resize((WIDTH, round(WIDTH * whole.height / whole.width)), Image.Resampling.LANCZOS))
        browser.close()
    durations = [FRAME] * (len(pictures) - 1) + [LAST]
    first, *others = pictures
    first.save(TARGET, save_all=True, append_images=others, duration=durations, loop=0, quality=70, method=6)
    print(f"{TARGET}: {TARGET.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
