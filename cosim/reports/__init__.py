"""What a run leaves behind: summary, tables, plots and the report."""
