"""Input shapers: impulse sequences that suppress residual vibration, and motions convolved with them."""
