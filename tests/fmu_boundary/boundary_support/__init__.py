"""What the tests at the FMI boundary share."""
