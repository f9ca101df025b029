"""Continue from a serialised state in a process of its own.

python -m flexfmu.fmu_build.checks.elsewhere FOLDER KIND STEPS STATE RESULT
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.checks.fmu import FmuUnderTest, Kind
from flexfmu.fmu_build.checks.replay import continue_from


def main() -> None:
    """Write what the FMU gives from the state on."""
    folder, kind, steps, state, result = sys.argv[1:]
    description = read_model_description(folder, validate=False)
    fmu = FmuUnderTest(description, Path(folder), Kind[kind], int(steps))
    np.save(result, continue_from(fmu, Path(state).read_bytes()))


if __name__ == "__main__":
    main()
