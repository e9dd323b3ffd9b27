"""How a fit ended. Nothing is computed here, so that those who only tell of fits import little."""

from enum import IntEnum

RUNNING, CONVERGED, STEPS_EXHAUSTED, NOT_FINITE, SINGULAR = range(5)
"""How a fit stands."""


class Result(IntEnum):
    """How the fit of one arm ended."""

    CONVERGED = CONVERGED
    STEPS_EXHAUSTED = STEPS_EXHAUSTED
    NOT_FINITE = NOT_FINITE
    SINGULAR = SINGULAR
    TOO_FEW_SAMPLES = 5
    UNREADABLE = 6

    @property
    def message(self) -> str:
        """One line for a person."""
        return {
            Result.CONVERGED: "converged",
            Result.STEPS_EXHAUSTED: "did not converge in the steps allowed; check the arm's model, or allow more steps",
            Result.NOT_FINITE: "met a number that is not finite; check the input",
            Result.SINGULAR: "does not determine every parameter; record poses that move every joint",
            Result.TOO_FEW_SAMPLES: "has fewer measured numbers than parameters; record more poses",
            Result.UNREADABLE: "could not be read",
        }[self]
