"""Estimation for any problem with residuals and columns: robust least squares, noise models, score tests."""
