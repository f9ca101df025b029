"""FMUs as slaves: files, instances, variables, and the FMI 2.0 and 3.0 calls."""
