"""SSP files: read, run and written."""
