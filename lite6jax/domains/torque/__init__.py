"""Torques of motors as the quantity that is measured."""
