"""Recordings in other tools' forms: pandas, xarray, Parquet, MATLAB, MCAP, Matplotlib; each module needs one library."""
