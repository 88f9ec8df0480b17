"""Numerical stress tests: the native library compared to its definition, on the user's machine.

A case is a function that generates its input, computes an oracle, and returns errors with
tolerances; `gscore stress` and the tests run the same cases. docs/accuracy-tests.md lists them.
"""

from .run import Outcome, run_cases, select
