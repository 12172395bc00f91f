"""The errors that OpenClone raises for input it cannot use."""


class OpenCloneError(Exception):
    """Base of every error a user can cause; its text is one line with a remedy.

    The command line prints the text and exits with code 2, without a traceback.
    """


class InputError(OpenCloneError):
    """A file or value from outside is malformed.

    The message names the file, the place in it and the remedy.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        """Compose ``where: what; remedy`` from its parts."""
        text = f"{where}: {what}" if where else what
        super().__init__(f"{text}; {remedy}" if remedy else text)
        self.where = where
        self.remedy = remedy
