"""Fitting a sensor to pictures of a real one: press pictures, where each press is, the fit, and what it is worth."""
