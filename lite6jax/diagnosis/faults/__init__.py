"""Faults of a recording: looked for, said, put right before physics, and weighed against it where it looks alike."""
