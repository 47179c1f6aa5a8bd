"""Hidden cases for the discrepancy workflow: recordings in one folder, the truth sealed in another.

A process of its own (`python -m benchmarks._blind`) makes them. Nothing of `simulators` is imported: motion, noise and
effects are written anew from their plain definitions, so that a slip in the library cannot hide behind itself.
"""
