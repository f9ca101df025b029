"""The model of shapes against finite elements and Exudyn: the paper's scenes, at rest and in motion.

All numbers are relative differences, as `tests/formulations.py` defines them. Exudyn's beams have no shear, and it isn't
needed for the rest: pip install flexfmu[peers]. Takes about six minutes, large deflections alone two.

    python benchmarks/references.py [--json] [--large-deflections]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))  # the comparison with other formulations

from formulations import (
    Beam,
    ComputedMotion,
    compare_at_rest,
    compare_motions,
    full_scene,
    sample_instants,
    shapes_motion,
)

from flexfmu import load_scene
from flexfmu.cosim.engine.slave import RealArray
from flexfmu.cosim.experiment.planning import MotionPlan, plan
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.many.prepared_scene import run_scene
from flexfmu.cosim.metrics.small_deflections import largest_deflection, path_errors
from flexfmu.model.finite_elements.motion import simulate
from flexfmu.model.finite_elements.robot import finite_element_robot
from flexfmu.model.scene.schema import Scene

SCENES = ("barnard2012-6kg", "barnard2012-0.1kg")
BEAMS: tuple[Beam, ...] = ("euler-bernoulli", "timoshenko")
HAS_EXUDYN = find_spec("exudyn") is not None

ELEMENTS, STEP = 8, 2.5e-4
"""Elements of a link and step of the integrator [s] of the converged solution."""

FEWER_ELEMENTS = (1, 2, 4)

EXUDYN_MESHES = ((2, 2.5e-4), (4, 2.5e-4), (4, 1e-4), (4, 5e-5))
"""Elements a link and steps [s], the best last."""

SOFTENED = (
    *((SCENES[0], factor) for factor in (1.0, 5.0, 20.0, 30.0, 60.0)),
    *((SCENES[1], factor) for factor in (20.0, 100.0)),
)
"""Scenes, and how many times softer than theirs the material is."""

THEORIES = {False: "without foreshortening", True: "with foreshortening", "exact": "exact bending"}

Row = dict[str, str | float]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="The model of shapes against other formulations.")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    parser.add_argument("--large-deflections", action="store_true", help="the last table alone")
    options = parser.parse_args()
    rows = [*([] if options.large_deflections else measure()), *large_deflections()]
    if options.json:
        print(json.dumps(rows, indent=2))
        return
    for title, table in groupby(sorted(rows, key=lambda row: str(row["table"])), key=lambda row: row["table"]):
        print(f"\n{title}\n")
        print_table([{key: value for key, value in row.items() if key != "table"} for row in table])


def measure() -> Iterator[Row]:
    """All scenes, both theories of beams; every row names the table that it belongs to."""
    for name in SCENES:
        for beam in BEAMS:
            yield from compare(load_scene(name), beam)


def compare(scene: Scene, beam: Beam) -> Iterator[Row]:
    """The scene's robot without and with foreshortening, which all references have."""
    motion = plan(scene)
    instants = sample_instants(motion)
    extensible = full_scene(scene, beam, foreshortening=True)
    exact = run_elements(extensible, motion, instants, ELEMENTS)
    others = {"finite elements": exact}
    if beam == "euler-bernoulli":
        label: Row = {"table": "Convergence, differences to 8 elements", "scene": scene.name}
        for reference, theirs in coarser(extensible, motion, instants):
            yield label | {"formulation": reference} | asdict(compare_motions(theirs, exact, motion, instants))
        if HAS_EXUDYN:
            others["Exudyn"] = theirs
    for foreshortening in (False, True):
        full = full_scene(scene, beam, foreshortening)
        ours = shapes_motion(full, instants)
        row: Row = {"scene": scene.name, "beam": beam, "foreshortening": "yes" if foreshortening else "no"}
        at_rest = asdict(compare_at_rest(full, motion, finite_element_robot(full, ELEMENTS)))
        yield {"table": "At rest, model of shapes against finite elements"} | row | at_rest
        for reference, theirs in others.items():
            row |= {"table": "In motion, model of shapes against others", "reference": reference}
            yield row | asdict(compare_motions(ours, theirs, motion, instants))


def large_deflections() -> Iterator[Row]:
    """Links so soft that they bend far: errors of the path against 4 elements a link, and what a run itself estimates of them."""
    for name, factor in SOFTENED:
        scene = load_scene(name)
        fmus = {short: build_scene(full_scene(scene, "euler-bernoulli", short)).path for short in THEORIES}
        scene = scene.replace({"mechanism.material.youngs_modulus": scene.mechanism.material.youngs_modulus / factor})
        motion = plan(scene)
        instants = sample_instants(motion)
        exact = full_scene(scene, "euler-bernoulli", foreshortening=True)
        theirs = simulate(finite_element_robot(exact, 4), motion.joints, instants, 1e-3)
        row: Row = {"table": "Large deflections, path against finite elements", "scene": scene.name, "softer": factor}
        for short, fmu in fmus.items():
            ours, text = full_scene(scene, "euler-bernoulli", short), THEORIES[short]
            run = run_scene(ours, communication_step=1e-3, tolerance=1e-8, fmu_path=fmu)
            true = compare_motions(shapes_motion(ours, instants, fmu), theirs, motion, instants).position
            row |= {"deflection": largest_deflection(run)} if short is True else {}
            row |= {text: true} | ({} if short == "exact" else {f"estimated {text}": path_errors(run)[0]})
        yield row


def coarser(scene: Scene, motion: MotionPlan, instants: RealArray) -> Iterator[tuple[str, ComputedMotion]]:
    """With fewer elements, and by Exudyn with finer and finer meshes."""
    for elements in FEWER_ELEMENTS:
        yield f"{elements} elements", run_elements(scene, motion, instants, elements)
    if HAS_EXUDYN:
        from flexfmu.benchmarks.peers.exudyn_peer import simulate_exudyn

        for elements, step in EXUDYN_MESHES:
            run = simulate_exudyn(scene, motion, instants, step, elements)
            yield f"Exudyn, {elements} elements, {1e3 * step:g} ms, {run.time:.1f} s of CPU", run


def run_elements(scene: Scene, motion: MotionPlan, instants: RealArray, elements: int) -> ComputedMotion:
    """Our own finite elements."""
    return simulate(finite_element_robot(scene, elements), motion.joints, instants, STEP)


def print_table(rows: Sequence[Row]) -> None:
    """As Markdown."""
    for cells in (list(rows[0]), ["---"] * len(rows[0])):
        print("| " + " | ".join(cell.replace("_", " ") for cell in cells) + " |")
    for row in rows:
        print("| " + " | ".join(each if isinstance(each, str) else f"{each:.2e}" for each in row.values()) + " |")


if __name__ == "__main__":
    main()
