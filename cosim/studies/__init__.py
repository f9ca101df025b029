"""Studies of the toolkit itself: the paper's tables, accuracy against time, hard cases, references."""
