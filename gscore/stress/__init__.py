"""Numerical stress tests: the library against its definition, on the user's own machine.

A case is a function that draws its own input, asks an oracle, and returns errors with tolerances;
`gscore stress` and the tests run the same cases. docs/accuracy-tests.md lists them.
"""

from .run import Outcome, run_cases, select

__all__ = ["Outcome", "run_cases", "select"]
