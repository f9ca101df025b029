"""Imperfections of drives and sensors: delay, lag, noise, quantisation, jitter, limits, payload error."""
