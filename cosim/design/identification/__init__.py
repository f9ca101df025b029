"""Parameters from measurements: logs and frequency responses, coloured noise, least squares, intervals, and which motion would tell more."""
