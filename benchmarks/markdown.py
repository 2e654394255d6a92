"""Tables of the pages that are made of results, and the places where they stand."""

import re
from collections.abc import Callable, Iterable


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table, the first column to the left and the others to the right."""
    head = list(head)
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def filled(page: str, body: Callable[[str], str], family: str = "") -> str:
    """The page with every block of a family written anew: `body(name)` between its markers.

    These are `<!-- family: name -->` and `<!-- family end -->`, without a family `<!-- name -->` and `<!-- end -->`. A
    block ends before the next marker of any family.
    """
    begin, end = (f"{family}: ", f"{family} end") if family else ("", "end")

    def block(found: re.Match) -> str:
        return f"<!-- {begin}{found[1]} -->\n{body(found[1])}\n<!-- {end} -->"

    return re.sub(rf"<!-- {begin}(\w+) -->\n(?:(?!<!-- ).)*<!-- {end} -->", block, page, flags=re.DOTALL)
