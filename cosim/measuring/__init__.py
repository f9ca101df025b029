"""Recorded signals as continuous solutions between their samples: what metrics and plots are taken from."""
