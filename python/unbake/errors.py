"""What can go wrong. Every message names the file, the place in it, what was expected and the way out; it is the program's own."""


class Error(Exception):
    """Anything that unbake refuses or fails at."""


class InputError(Error, ValueError):
    """Input that cannot be used: a scene, a result, a list of cameras."""


class UsageError(Error, ValueError):
    """Arguments that contradict each other, do not exist or are out of range."""


class FileError(Error, OSError):
    """The system refused to read or write a file."""
