"""What tests and benchmarks compare with: plain NumPy, SciPy and Pinocchio, sharing no code with the library."""
