"""What reading and writing says when something is wrong, or was assumed."""

LONGEST = 500
"""Characters of a sentence."""


class MotionFormatError(ValueError):
    """Something is wrong with a file: one sentence that names the file, the place, and what to do.

    It quotes what files hold: its middle is left out where that is long, and what cannot be printed is escaped.
    """

    def __init__(self, sentence: str):
        if len(sentence) > LONGEST:
            sentence = f"{sentence[: LONGEST * 2 // 3]} ... {sentence[-LONGEST // 3 :]}"
        super().__init__("".join(c if c.isprintable() else ascii(c)[1:-1] for c in sentence))


class MotionFormatWarning(UserWarning):
    """A file leaves something out and a value was assumed: one sentence with the argument that overrides it."""
