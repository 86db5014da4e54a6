"""What can go wrong, in words."""


class DriftlessError(Exception):
    """Any error of this package."""


class NoAnswer(DriftlessError):
    """No server answered before the deadline, or it was busy throughout."""


class Refused(DriftlessError):
    """The server refused a query; the same query will be refused again."""

    def __init__(self, code: str, message: str):
        super().__init__(f"{message} ({code})")
        self.code = code
        """`unknown_map`, `bad_request`, `schema_mismatch`, ..."""


class Unreadable(DriftlessError):
    """A message or a file that is not what it should be; says which."""
