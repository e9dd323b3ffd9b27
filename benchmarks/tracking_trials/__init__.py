"""Concealed logs of commands: a generator that shares no code with the library, sealed truths, honest scores."""
