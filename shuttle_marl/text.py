"""Text from files and from users, made fit to be printed."""


def described(error: BaseException) -> str:
    """The type and the message of an error that code of others raised; never fails itself."""
    try:
        message = str(error)
    except Exception:
        message = "(its message cannot be read)"
    return f"{type(error).__name__}: {message}"


def printable(text: str, *, keep: str = "") -> str:
    r"""Replace every character that a terminal does not print by its escape, such as ``\x1b`` or ``\u202e``.

    Names in files come from others: control characters in them move the cursor, change colours and titles, or reverse the
    order of the line; halves of a surrogate pair (undecodable bytes of a path) cannot be written at all.

    Args:
        text: any text.
        keep: characters that stay although they are not printable, such as a newline.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii") for c in text)
