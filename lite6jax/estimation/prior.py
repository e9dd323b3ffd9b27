"""The prior probabilities of explanations: physics, faults of the data, and errors of what was declared.

An explanation of probability p costs −ln p nats of evidence. Where p is shared by several, as a kind by its names, each
has its part of it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

from lite6jax.errors import InputError
from lite6jax.estimation.documented import documented, option
from lite6jax.fields import field_values


@final
@dataclass(frozen=True)
class Prior:
    """Prior probabilities, each from 0 to below 1.

    For example, `Prior(calibration_off=0.02)` is that of a laboratory in which one calibration file in fifty is stale.

    Raises:
        InputError: one is not in this range.
    """

    # physics, of a term that a model lacks
    named: float = option(0.25, "a term is an effect with a name, any of them", "four kinds, equally probable")
    wave: float = option(0.25, "it is a wave of a turn, of any order", "as above")
    process: float = option(0.25, "it is a function of one driver, at any component", "as above")
    product: float = option(0.25, "it is a function of two drivers, at any component", "as above")
    repeating: float = option(
        0.01,
        "it repeats with a turn, at any order, and is no sine",
        "most such parts are eccentric, of two orders by name",
    )
    modulated: float = option(
        0.05,
        "it is a wave of a turn, of any order, whose size follows another driver",
        "most waves are of one size",
    )
    overtone: float = option(0.5, "a wave has one of twice its order beside it", "parts are eccentric and out of round")
    usual: float = option(0.5, "an effect that nearly every problem has is there", "such as the friction of a drive")
    own_driver: float = option(0.6, "a function depends on a driver of its own site", "most physics acts where it is")
    command_shift: float = option(
        0.1,
        "a function in the loop of a servo shifts its command, against that it is a torque",
        "friction and cables are everywhere, few commands are changed on their way",
    )
    readout_shift: float = option(
        0.3,
        "it shifts the read-out, against that it is a torque",
        "read-outs err less often than drives bind",
    )
    whole_order: float = option(2 / 3, "the order of a wave is whole", "most gears have whole orders")
    # read-outs, besides the four kinds
    wandering: float = option(0.25, "a read-out wanders by itself, any of them", "as each kind of physics")
    alike: float = option(0.5, "a read-out wanders too where one of its kind does", "read-outs of a kind are alike")
    autocorrelated_noise: float = option(
        0.25, "rows of a group remember what their noise was, with any memory and share", "as each kind of physics"
    )
    jump: float = option(
        1 / 300, "a read-out jumps once, any of them, at any sample", "one file in 300, as a data fault"
    )
    # what nobody recorded, besides the four kinds
    hidden_state: float = option(
        0.02,
        "what is no read-out wanders by itself, any component of any site",
        "one recording in fifty: a read-out at which the same shows is the likelier",
    )
    time_itself: float = option(
        1 / 400,
        "what wanders is a function of the time, against that nobody recorded what drives it",
        "time drives nothing: a likelihood ratio of six nats is asked for",
    )
    # what was declared
    wrong_input: float = option(0.1, "a declared input such as a load is wrong", "one case in ten")
    calibration_off: float = option(0.1, "all numbers of the calibration file are off a little", "one file in ten")
    nominal_table: float = option(1 / 300, "another nominal table than the file's holds", "one file in 300")
    # faults of the data
    data_fault: float = option(1 / 300, "columns, units, zeros, a frame or a tool are wrong", "one file in 300")
    distance_constant: float = option(1 / 300, "a gauge of distances has a zero of its own", "as another fault")
    frame_jump: float = option(1 / 300, "the sensor, the base or the tool was moved once, at any row", "as above")
    unsettled_readouts: float = option(1 / 300, "read-outs were taken before all had come to rest", "as above")

    def __post_init__(self) -> None:
        for name, probability in self.probabilities.items():
            if not 0 <= probability < 1:
                raise InputError(f"prior: {name} is {probability}; give a probability from 0 to below 1")

    @cached_property
    def probabilities(self) -> dict[str, float]:
        """Each by its name."""
        return {name: float(probability) for name, probability in field_values(self).items()}

    @property
    def entries(self) -> dict[str, dict[str, float | str]]:
        """The probability of each kind of explanation, what it costs in nats, what it says, and why it is so."""
        return {
            entry.name: {
                "probability": entry.value,
                "cost": self.cost(entry.name),
                "meaning": entry.meaning,
                "why": entry.why,
            }
            for entry in documented(self)
        }

    def cost(self, name: str) -> float:
        """−ln of a probability, nats."""
        probability = self.probabilities[name]
        return -math.log(probability) if probability else math.inf

    def given(self, probabilities: Mapping[str, float]) -> "Prior":
        """With other probabilities, as the key `prior` of a sidecar gives them.

        Raises:
            InputError: a name that is none, or a number that is no probability.
        """
        unknown = sorted(set(probabilities) - set(self.probabilities))
        if unknown:
            raise InputError(f"prior: {unknown[0]!r} is no explanation; the names are {', '.join(self.probabilities)}")
        return replace(self, **probabilities)


PRIOR = Prior()
"""The prior of a recording of which nothing else is known."""
