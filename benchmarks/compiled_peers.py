"""Time for the same error: flexfmu against compiled integrators at their best, on the same generated functions with exact Jacobians.

RADAU5 in Fortran, SUNDIALS' IDA and ARKODE in C (`peers/compiled_peer.py` says where they come from and how they are set), all outputs at
1 kHz, compiled at -O3 for this processor. Ours is the whole co-simulation with our master. Times are processor times of the best of
several runs, interpolated on the curve of each tool's best settings: for ours integrators, tolerances and fixed steps, each sweep from loose to
tight. Errors of positions are relative to the largest elastic deviation, counted from our run at 1e-12.

- motion: the paper's motion with 6 kg, joints driven;
- PD at 4 kHz: the same robot driven by torques, which jump at each sample, where all integrators restart;
- 400 payloads: the peak torque of each, ours side by side in the lanes of the processor, against as many runs of a peer, whose torques
  at 1 kHz have the same error.

    python benchmarks/compiled_peers.py [--json]

fetches what it needs where it can (pip and a Fortran compiler for RADAU5, Debian's libsundials-dev for SUNDIALS), and says what is missing.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from paper_scene import SCENE, run_and_read
from speed_loops import DRIVEN, LONG_LOOP, SAMPLE_TIME

from flexfmu.benchmarks.peers.compiled_peer import (
    SETTINGS,
    TOLERANCES,
    CompiledPeers,
    PeerMissingError,
    PeerSetting,
    fetch,
    missing,
    positions,
)
from flexfmu.cosim.engine.results import Selection
from flexfmu.cosim.experiment.accuracy import WorkCurve, WorkPrecisionTrial
from flexfmu.cosim.experiment.scene_build import build_scene
from flexfmu.cosim.experiment.timing import fastest
from flexfmu.cosim.many.prepared_scene import PreparedScene
from flexfmu.cosim.many.variants import SideBySide
from flexfmu.cosim.studies.workprec.trial import RunError, completed, subject_of
from flexfmu.model.scene.schema import Scene

STEP = 1e-3
"""Spacing of recorded instants [s]."""

ERRORS = (1e-3, 1e-5, 1e-7)
"""Errors at which times are compared."""

LOOP = DRIVEN.replace({key: value for key, value in LONG_LOOP.items() if key != "imperfection"})

INTEGRATORS = ("automatic", "radau3-dense", "gauss3", "gauss4")

COMPARED: Mapping[str, Sequence[PeerSetting]] = {**SETTINGS, "RADAU5 as it comes": SETTINGS["RADAU5"][:1]}
"""Peer → settings of its curve: all of them, and RADAU5 besides in the form and with the settings that its users begin with."""

SLOWEST = 0.5
"""A sweep of a peer ends at a run that takes this long [s]."""

PAYLOADS = np.linspace(0.1, 8.0, 400)
PEAK_ERROR = 1e-4
TORQUES = ("joint1.torque", "joint2.torque")
BATCHES = tuple(
    (step, tolerance, {} if fixed is None else {"cosimulation.integrator_step": fixed, "cosimulation.integrator": name})
    for name, fixed, step in (
        ("automatic", None, 1e-3),
        ("automatic", None, 2e-3),
        ("radau3", 2e-3, 2e-3),
        ("gauss3", 2e-3, 2e-3),
    )
    for tolerance in (1e-3, 1e-4, 1e-5)
)
"""Communication step [s], tolerance and changes of the scene for variants side by side."""


def main() -> int:
    """Measure and print; the exit status."""
    parser = argparse.ArgumentParser(description="Time for the same error: flexfmu against compiled integrators.")
    parser.add_argument("--json", action="store_true", help="print JSON and nothing else")
    options = parser.parse_args()
    try:
        fetch()
    except PeerMissingError as failure:
        print(failure, file=sys.stderr)
    absent = {peer: note for peer in SETTINGS if (note := missing(peer))}
    present = [setting for peer, settings in SETTINGS.items() if peer not in absent for setting in settings]
    for peer, note in absent.items():
        print(f"{peer} is left out: {note}", file=sys.stderr)
    peers = [peer for peer, settings in COMPARED.items() if settings[0] in present]
    rows = [*single("motion", SCENE, STEP, peers), *single("PD at 4 kHz", LOOP, SAMPLE_TIME, peers), *batched(peers)]
    if options.json:
        print(json.dumps(rows, indent=2))
        return 0
    print(f"{'':12} {'error':>8} {'flexfmu':>10}" + "".join(f"{peer:>34}" for peer in peers))
    for row in rows:
        cells = (
            f"{1e3 * time:.2f} ms, {time / row['flexfmu']:.1f} ×" if (time := row[peer]) else "not reached"
            for peer in peers
        )
        print(
            f"{row['case']:12} {row['error']:8.0e} {1e3 * row['flexfmu']:7.3f} ms"
            + "".join(f"{each:>34}" for each in cells)
        )
    return 0


def single(case: str, scene: Scene, step: float, peers: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the times of single runs for each of `ERRORS`."""
    subject = subject_of(scene)
    compiled = CompiledPeers(scene, STEP) if peers else None

    def ours() -> Iterator[WorkPrecisionTrial]:
        for name in INTEGRATORS:
            for fixed in (None, step):
                section = {"cosimulation.integrator": name} | ({"cosimulation.integrator_step": fixed} if fixed else {})
                for tolerance in TOLERANCES[:9]:
                    record = Selection(None, order=0, step=STEP)
                    options = {"communication_step": step, "tolerance": tolerance, "record": record}
                    prepared = PreparedScene(scene.replace(section), **options)
                    error = subject.error(subject.positions(completed(prepared.run())))
                    time = fastest(lambda prepared=prepared: run_and_read(prepared))
                    yield WorkPrecisionTrial(case, "flexfmu", f"{name} {fixed} {tolerance:.0e}", error, time)

    curves = {"flexfmu": WorkCurve.of(ours())}
    for peer in peers:
        curves[peer] = WorkCurve.of(peer_trials(compiled, peer, lambda run: subject.error(positions(run))))
    for error in ERRORS:
        yield {"case": case, "error": error} | {name: curve.time(error) for name, curve in curves.items()}


def peer_trials(compiled: CompiledPeers, peer: str, error: Callable[[Any], float]) -> Iterator[WorkPrecisionTrial]:
    """Yield runs of a peer over all of its settings."""
    for setting in COMPARED[peer]:
        for tolerance in TOLERANCES:
            try:
                run = compiled.run(setting, tolerance)
            except RunError as failure:
                yield WorkPrecisionTrial("", peer, f"{tolerance:.0e}", None, None, str(failure))
                continue
            yield WorkPrecisionTrial("", peer, f"{tolerance:.0e} {setting[0]}", error(run), run.time)
            if run.time > SLOWEST:
                break


def batched(peers: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the time of a variant among many for `PEAK_ERROR`."""
    fmu, changes = build_scene(SCENE).path, [{"payload.mass": float(mass)} for mass in PAYLOADS]

    def peaks(step: float, tolerance: float, section: dict[str, Any]) -> tuple[np.ndarray, float]:
        batch = SideBySide(SCENE.replace(section), fmu, step, tolerance)
        found = batch.peaks(changes, TORQUES)
        assert None not in found
        values = np.array([[each[name] for name in TORQUES] for each in found])
        return values, fastest(lambda: batch.peaks(changes, TORQUES)) / len(changes)

    exact, _ = peaks(5e-4, 1e-11, {})

    def ours() -> Iterator[WorkPrecisionTrial]:
        for setting in BATCHES:
            values, time = peaks(*setting)
            yield WorkPrecisionTrial("", "flexfmu", str(setting), float(abs(values / exact - 1.0).max()), time)

    row: dict[str, Any] = {
        "case": "400 payloads",
        "error": PEAK_ERROR,
        "flexfmu": WorkCurve.of(ours()).time(PEAK_ERROR),
    }
    if peers:
        compiled = CompiledPeers(SCENE, STEP)
        reference = PreparedScene(
            SCENE, communication_step=STEP, tolerance=1e-12, record=Selection(TORQUES, order=0)
        ).run()
        recording = reference.recording
        at = np.searchsorted(recording.time, compiled.instants[1:] - 1e-9)
        truth = {name: recording[name].values[at] for name in TORQUES}

        def error(run: Any) -> float:
            return max(
                float(abs(run.outputs[name][1:] - truth[name]).max() / abs(truth[name]).max()) for name in TORQUES
            )

        row |= {peer: WorkCurve.of(peer_trials(compiled, peer, error)).time(PEAK_ERROR) for peer in peers}
    yield row


if __name__ == "__main__":
    sys.exit(main())
