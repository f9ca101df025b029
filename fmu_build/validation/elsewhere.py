"""Run an FMU in a process of its own, from the start or from a serialised state.

python -m flexfmu.fmu_build.validation.elsewhere FOLDER KIND PACE STATE RESULT
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from fmpy.model_description import read_model_description

from flexfmu.fmu_build.validation.fmu import FmuUnderTest, Kind
from flexfmu.fmu_build.validation.replay import continue_from


def main() -> None:
    """Write what the FMU gives."""
    folder, kind, pace, state, result = sys.argv[1:]
    fmu = FmuUnderTest(read_model_description(folder, validate=False), Path(folder), Kind[kind], float(pace))
    np.save(result, continue_from(fmu, Path(state).read_bytes()))


if __name__ == "__main__":
    main()
