"""What the tests of exported FMUs share."""
