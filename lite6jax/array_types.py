"""The types of NumPy's arrays, each by one name; shapes are in docstrings. Those of JAX are `jax.Array`."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]
"""Real numbers."""
Mask = NDArray[np.bool_]
"""True where a row, or another member of an axis, is meant."""
Integers = NDArray[np.integer]
"""Numbers of rows, of runs or of joints."""
AnyArray = NDArray[Any]
"""Numbers, texts or objects, as files hold them."""
