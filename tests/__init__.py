"""The tests; a package, so that `tests.oracles` is found before any other `tests` on the path."""
