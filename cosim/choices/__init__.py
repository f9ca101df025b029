"""Effects and input shapers, chosen by what runs show."""
