"""Measurements: each module runs alone (`python -m benchmarks.NAME --json FILE`) and asserts nothing about time."""
