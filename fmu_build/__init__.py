"""From a symbolic model to an FMI 2.0 FMU: C code, model description, compilation, archive; knows no five-bar."""
