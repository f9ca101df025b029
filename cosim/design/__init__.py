"""Design by numbers: effects, input shapers, gains, margins and plans, each verified by co-simulation."""
