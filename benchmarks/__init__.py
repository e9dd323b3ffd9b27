"""Workloads × rivals in one run, answers checked where they can be: `python -m benchmarks [NAME] [--json OUT]`."""
