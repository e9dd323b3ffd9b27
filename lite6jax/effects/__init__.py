"""What an arm can also do: one small pure function for each effect, the catalogue, loads, how effects compose."""
