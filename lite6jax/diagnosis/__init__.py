"""What makes a recording depart from the arm's model: located, named, modelled and verified."""
