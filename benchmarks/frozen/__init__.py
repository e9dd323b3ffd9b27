"""Diagnoses that were frozen: whole documents of recordings of all kinds, and what the tree says of the same now."""
