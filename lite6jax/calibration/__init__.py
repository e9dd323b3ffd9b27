"""The geometry of one arm or of many: source, problem, start, residual, solvers, solution."""
