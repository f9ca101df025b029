"""Recordings in files and in other tools' forms: CSV, pandas, xarray, Parquet, MATLAB, MCAP, Matplotlib."""
