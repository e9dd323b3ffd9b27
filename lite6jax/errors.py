"""The one error a user's input can cause."""


class InputError(ValueError):
    """Something given from outside cannot be used.

    The message is one line that names the file, the place in it and the remedy;
    the command line prints it and exits with code 2.
    """
