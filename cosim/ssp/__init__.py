"""System Structure and Parameterization (SSP) 1.0, https://ssp-standard.org: whole scenes as one file, and such files run, of other tools too."""
