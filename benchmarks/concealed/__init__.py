"""Trials whose hidden physics a generator draws that shares no code with the library; sealed first and opened last."""
