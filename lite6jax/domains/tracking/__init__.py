"""Commanded against measured joints: rollouts of servos, their problem, and what a diagnosed arm does with commands."""
