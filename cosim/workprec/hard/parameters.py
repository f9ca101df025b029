"""Robots far from the paper's: payload, thickness and stiffness at their ends, through parameters of one FMU."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

from flexfmu.cosim.measuring.small_deflections import exceeded
from flexfmu.cosim.workprec.hard.case import Check, Finding, HardCase
from flexfmu.cosim.workprec.hard.judging import error_against, soundness
from flexfmu.cosim.workprec.hard.reference import Solver
from flexfmu.cosim.workprec.hard.robots import ALLOWED, paper_robot, run_case

STIFF = Solver("LSODA", 1e-11)
"""Stiff: heavy payloads on light links swing slowly, the links between them fast."""


def cases() -> Iterator[HardCase]:
    """Payload, rods, material."""
    rods = "mechanism.proximal.diameter", "mechanism.distal.diameter"
    modulus = "mechanism.material.youngs_modulus"
    yield _case("no payload", "0 kg at the end effector: it has no mass of its own", {"payload.mass": 0.0})
    yield _case("payload of 60 kg", "19 times the mass of the links", {"payload.mass": 60.0}, bent=True)
    yield _case(
        "rods of 5 mm",
        "bending stiffness 2400 times lower, 6 kg on 0.066 kg of links",
        dict.fromkeys(rods, 0.005),
        bent=True,
    )
    yield _case("rods of 80 mm", "bending stiffness 27 times higher", dict.fromkeys(rods, 0.08))
    yield _case("Young's modulus x 1e-3", "70 MPa: links like rubber", {modulus: 70e6}, bent=True)
    yield _case(
        "Young's modulus x 1e3", "70 TPa: modes at 32 times the frequency, deflections of 0.2 µm", {modulus: 70e12}
    )


def _case(name: str, hard: str, changes: Mapping[str, Any], bent: bool = False) -> HardCase:
    return HardCase(name, hard, partial(_run, changes, bent))


def _run(changes: Mapping[str, Any], bent: bool) -> Finding:
    """Against LSODA on the same equations; large deflections must be told."""
    run = run_case(paper_robot(), changes)
    warnings = exceeded(run)
    told = Check("warnings of large deflections missing", float(bent != bool(warnings)), 0.0)
    checks = (error_against(run, paper_robot(), STIFF, ALLOWED), *soundness(run), told)
    return Finding("; ".join([run.message, *warnings]), checks)
