"""The WebAssembly module: in Node it gives the native binary's bits, and its folder is a package for npm."""

from __future__ import annotations

import json
import subprocess
from base64 import b64decode
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexfmu.cosim.engine.fmu.slave import FmuSlave
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.fmu_build.errors import PlatformError
from flexfmu.fmu_build.toolchain import find_platforms
from flexfmu.model.scene.file import load_scene

STICTION: dict[str, Any] = {
    "cosimulation.drive": "torque",
    "effects.joint_friction": {"kind": "stiction", "coulomb": 2.0, "breakaway": 3.0, "viscous": 0.5},
}
CASES: dict[str, dict[str, Any]] = {"starter": {}, "stiction": STICTION}
STEPS, STEP, ORDER = 60, 1e-3, 2

SCRIPT = """
const { load } = await import(process.argv[2]);
const { inputs, outputs, fed, step } = JSON.parse(process.argv[3]);
const run = (await load()).instantiate().initialize();
const groups = [0, 1, 2].map((order) => run.group(inputs, order));
const found = [0, 1, 2].map((order) => run.group(outputs, order));
const all = new Float64Array(fed.length * 3 * outputs.length);
fed.forEach((rows, n) => {
  groups.forEach((group, order) => (group.values.set(rows[order]), group.write()));
  run.step(n * step, step);
  found.forEach((group, order) => all.set(group.read(), (3 * n + order) * outputs.length));
});
let refused = "";
try { run.set({ nothing: 1 }); } catch (error) { refused = error.message; }
run.free();
// what is freed is used again
const own = await load(), pages = [];
for (let n = 0; n < 20000; n++) {
  const one = own.instantiate().set({ "payload.mass": 2 });
  one.group(outputs);
  one.free();
  pages.push(own.exports.memory.buffer.byteLength);
}
if (pages.at(-1) !== pages[1000]) throw new Error(`memory grows from ${pages[1000]} to ${pages.at(-1)} bytes`);
let freed = "";
try { run.step(0, 1e-3); } catch (error) { freed = error.message; }
// a response that is awaited inside
const again = await load(Promise.resolve(new Response((await import("node:fs")).readFileSync(process.argv[4]))));
console.log(JSON.stringify([Buffer.from(all.buffer).toString("base64"), refused, freed, again.model.guid]));
"""


@pytest.fixture(scope="module")
def node() -> str:
    """Node, which the package playwright brings along."""
    driver = pytest.importorskip("playwright._impl._driver")
    return str(driver.compute_driver_executable()[0])


@pytest.mark.slow
@pytest.mark.usefixtures("zig")
@pytest.mark.parametrize("name", CASES)
def test_node_gives_the_native_bits(name: str, node: str, tmp_path: Path) -> None:
    """Values and derivatives of all outputs over steps with moving inputs, friction that sticks included."""
    scene = load_scene(name if name in CASES and not CASES[name] else "barnard2012-6kg").replace(CASES[name])
    slave = FmuSlave(build_scene(scene).path, output_order=ORDER)
    folder = tmp_path / "module"
    assert build_scene(scene, output=folder, platforms=["wasm32"]).path == folder
    # references or torques that move, with their derivatives
    slave.initialize(0.0, 1.0, scene.cosimulation.tolerance)
    ports = [(i, each) for i, each in enumerate(slave.variables)]
    inputs = np.array([i for i, each in ports if each.causality == "input" and not each.discrete])
    outputs = np.array([i for i, each in ports if each.causality == "output" and not each.discrete])
    starts = np.array([slave.variables[i].start or 0.0 for i in inputs])
    sizes = np.where(abs(starts) > 0.0, 0.02, 5.0 if "torque" in slave.variables[inputs[0]].name else 0.5)
    times, rate = STEP * np.arange(STEPS)[:, None], 40.0 + np.arange(inputs.size)
    fed = np.stack(
        [
            starts + sizes * (1 - np.cos(rate * times)),
            sizes * rate * np.sin(rate * times),
            sizes * rate**2 * np.cos(rate * times),
        ],
        1,
    )
    found = np.empty((STEPS, 1 + ORDER, outputs.size))
    for n, rows in enumerate(fed):
        slave.set(inputs, rows[0])
        slave.set_derivatives(inputs, rows[1:])
        slave.step(n * STEP, STEP)
        slave.get(outputs, found[n, 0])
        slave.get_derivatives(outputs, found[n, 1:])
    slave.terminate()
    # the same in Node
    names = {key: [slave.variables[i].name for i in each] for key, each in (("inputs", inputs), ("outputs", outputs))}
    script = tmp_path / "run.mjs"
    script.write_text(SCRIPT)
    asked = json.dumps({**names, "fed": fed.tolist(), "step": STEP})
    (module,) = folder.glob("*.wasm")
    command = [node, script, folder / "index.js", asked, module]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    content, refused, freed, again = json.loads(done.stdout)
    assert np.frombuffer(b64decode(content)).tobytes() == found.tobytes()
    assert refused == "there is no variable 'nothing'"
    assert freed == "fmi2DoStep: this instance was freed"
    assert again
    # what npm needs
    manifest = json.loads((folder / "package.json").read_text())
    assert all((folder / each).is_file() for each in [*manifest["files"], manifest["main"], manifest["types"]])


def test_a_module_is_no_part_of_an_fmu() -> None:
    """It is built by itself."""
    with pytest.raises(PlatformError, match="wasm32 is no part of an FMU"):
        find_platforms(["linux64", "wasm32"])
