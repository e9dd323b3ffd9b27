"""Faults of a recording, which come before physics: looked for, said, put right."""
