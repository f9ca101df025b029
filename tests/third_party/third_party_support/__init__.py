"""What the tests with other people's tools share."""
