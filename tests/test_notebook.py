"""In a notebook everything that one gets shows itself, once: HTML with table and picture, or a figure."""

from __future__ import annotations

import re
from base64 import b64decode
from io import BytesIO
from typing import Any

import pytest

SETUP = """
import flexfmu
scene = flexfmu.load_scene("barnard2012-6kg").replace({
    "effects.proximal_bending": 1, "effects.distal_axial": 0, "trajectory.dwell": 0.05, "cosimulation.step": 1e-3,
})
loop = scene.replace({
    "cosimulation.drive": "torque", "effects.motor_inertia": 0.1,
    "controller": [{"kind": "pd", "proportional": 5e3, "derivative": 50.0, "sample_time": 1e-3}],
})
"""

SHOWN = {
    "scene": "table",
    "flexfmu.reference_motion(scene)": "table and picture",
    "flexfmu.modes(scene, 3)": "table and picture",
    "flexfmu.modes(scene, 3).plot()": "figure",
    "run = flexfmu.run(scene); run": "table",
    "run.metrics": "table",
    "run.metrics.peak_torque_1": "words",
    "run.recording": "table",
    "run.plot()": "figure",
    "margins = flexfmu.margins(loop, poses=1); margins": "table and picture",
    "margins.plot()": "figure",
    'swept = flexfmu.sweep(scene, {"payload.mass": [1.0, 3.0, 6.0]}, processes=1); swept': "table and picture",
    "swept.plot()": "figure",
    'tuned = flexfmu.tune(loop, {"pd.derivative": (20.0, 80.0)}, trials=3, processes=1); tuned': "table and picture",
    "tuned.plot()": "figure",
    "compared = flexfmu.compare(run, scene.replace({'payload.mass': 3.0})); compared": "table and picture",
    "compared.plot()": "figure",
    'planned = flexfmu.plan_motion(scene, limits={"torque": 90.0}, methods=["flexible"], robust=False, processes=1); planned': "table and picture",
    "planned.plot()": "figure",
    "import matplotlib.pyplot; margins.plot()": "figure",
}
"""Cell → what it shows."""


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[Any]]:
    """Outputs of the cells of an executed notebook."""
    cells = [pytest.importorskip("nbformat").v4.new_code_cell(text) for text in (SETUP, *SHOWN)]
    book = pytest.importorskip("nbformat").v4.new_notebook(cells=cells)
    folder = str(tmp_path_factory.mktemp("notebook"))
    pytest.importorskip("nbclient").NotebookClient(
        book, timeout=600, kernel_name="python3", resources={"metadata": {"path": folder}}
    ).execute()
    return {cell.source: [each for each in cell.outputs if each.output_type != "stream"] for cell in book.cells[1:]}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the notebooks' machinery
def test_every_result_shows_itself_once(outputs: dict[str, list[Any]]) -> None:
    """One output for each cell, with the table and the picture that belong to it."""
    from PIL import Image

    assert outputs.keys() == SHOWN.keys()
    for cell, found in outputs.items():
        assert len(found) == 1, cell
        data, kind = found[0].data, SHOWN[cell]
        if kind == "figure":
            picture = Image.open(BytesIO(b64decode(data["image/png"])))
        else:
            html = data["text/html"]
            assert ("<td" in html) == ("table" in kind), cell
            image = re.search(r'src="data:image/(png|svg\+xml);base64,([^"]+)"', html)
            assert (image is not None) == ("picture" in kind), cell
            if image is None or image[1] != "png":
                assert image is None or b"<polyline" in b64decode(image[2])
                continue
            picture = Image.open(BytesIO(b64decode(image[2])))
        # neither empty nor plain
        assert min(picture.size) > 200, cell
        assert len(set(picture.convert("RGB").resize((200, 200)).getdata())) > 20, cell
