"""The error of invalid user input."""


class InputError(ValueError):
    """Invalid input of a user: a file, an argument or an option.

    The message is one line that names the file, the place in it and the remedy. The command line prints it and exits
    with code 2.
    """
