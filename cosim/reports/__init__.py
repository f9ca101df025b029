"""What a run leaves behind: summary, plots and the report."""
