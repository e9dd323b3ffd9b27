"""What is said of commands and the joints that follow them; their report is one of its own."""

from lite6jax.domains.words import Words
from lite6jax.formatting import NAMED

TRACKING_WORDS = Words(
    measured="commands",
    singular="command",
    special_units={**NAMED, "ratio": (1.0, ""), "rate": (1e6, "ppm"), "peak_to_peak_rad": (1e3, "mrad")},
    absent="has no commands; add cmd1_rad ... beside q1_rad ...",
)
