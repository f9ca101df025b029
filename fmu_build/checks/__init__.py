"""What an FMU is checked for, each kind of check in a file of its own."""
