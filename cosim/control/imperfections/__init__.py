"""What real drives and sensors do to signals: delay, lag, noise, quantisation, jitter, limits."""
