"""Which terms belong to a model, by their evidence; of any problem."""
