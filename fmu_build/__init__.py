"""Builds FMI 2.0 FMUs from symbolic models: C code, model description, compilation, archive; independent of the five-bar."""
