"""Answers to trials that take no time, in a module from which other processes could have them."""


def refusing(given):
    """No diagnosis."""
    raise OSError("no diagnosis here")


def dying(given):
    """The end of the process."""
    import os

    os._exit(1)


def dying_and_waiting(pipe, name, seed, first, last, keep):
    """Mutations of which one ends the process, one never ends, and one is a traceback."""
    import os
    import time

    pipe.send(None)
    for k in range(first, last):
        if k == 2:
            os._exit(9)
        if k == 4:
            time.sleep(60)
        pipe.send(("traceback" if k == 5 else "read", "why"))
