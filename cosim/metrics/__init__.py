"""What a run is worth: metrics of the continuous solution between communication points, each with its error."""
