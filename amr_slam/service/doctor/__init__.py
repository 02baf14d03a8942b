"""``amr-slam doctor``: what is wrong, and what to do next."""
