"""Work for processes of their own, in a module that takes no time to load there."""

import os


def work_of(number):
    """3 dies, 4 fails, the rest is doubled."""
    if number == 3:
        os._exit(1)
    if number == 4:
        raise KeyError(number)
    return 2 * number
