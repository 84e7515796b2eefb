"""The one exception that means: the user can fix this."""


class UserError(Exception):
    """A mistake in the input. The message is one line that says what is wrong and how to fix it.

    The command line prints it without a traceback and exits with code 2.
    """
