"""The public names. Importing the package enables 64-bit floats in JAX: fits here reach 1e-13 m."""

import jax

jax.config.update("jax_enable_x64", True)
