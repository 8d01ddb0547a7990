"""Numbers of things in sentences."""


def counted(number: int, thing: str) -> str:
    """As in "1 view" and "2 views"."""
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
