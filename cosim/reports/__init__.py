"""Results of a run for readers: summary, tables, plots and the HTML report."""
