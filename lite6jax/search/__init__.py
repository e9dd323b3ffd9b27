"""Which terms belong to a model: forward, backward, exchange, spectra and curves; of any problem."""
