"""What a recording shows that the arm's model does not have: located, named, modelled and verified."""
