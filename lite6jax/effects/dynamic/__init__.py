"""What adds to the torques of the motors: one small module per family of effects."""
