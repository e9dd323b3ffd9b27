"""Workloads × rivals in one run, every answer checked: `python -m benchmarks [NAME] [--json OUT]`."""
