"""What a model of what joints do, their torques or how they follow commands, says of its arm."""

from lite6jax.arms.arm import Arm
from lite6jax.array_types import Array


class JointModel:
    """A model of the joints of a moving arm.

    Attributes:
        arm: its chain.
    """

    arm: Arm

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.arm.dof

    @property
    def sliding(self) -> tuple[int, ...]:
        """The prismatic joints, counted from 0."""
        return self.arm.sliding

    @property
    def joint_limits(self) -> Array:
        """`(joint, 2)` rad, m of prismatic joints."""
        return self.arm.joint_limits

    @property
    def motion(self) -> str:
        """Torques and commands are of a moving arm."""
        return "trajectory"
