"""The paper's experiment: its tables and figures beside ours."""
