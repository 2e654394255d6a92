"""What reading and writing says when something is wrong, or was assumed."""


class MotionFormatError(ValueError):
    """Something is wrong with a file: one sentence that names the file, the place, and what to do."""


class MotionFormatWarning(UserWarning):
    """A file leaves something out and a value was assumed: one sentence with the argument that overrides it."""
