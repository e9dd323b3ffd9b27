"""`python -m lite6jax.cli`, where no script is installed."""

import sys

from lite6jax.cli import main

sys.exit(main())
