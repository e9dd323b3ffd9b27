"""The geometry of one arm or of many: start, residual, two solvers, solution."""
