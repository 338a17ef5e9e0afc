"""What the scripts of this folder share: text between two marks of a page is replaced."""

import pathlib

PAGES = pathlib.Path(__file__).parent.parent / "src"


def table(head, rows):
    """Markdown lines of a table; `head` names the columns."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return lines + ["| " + " | ".join(row) + " |" for row in rows]


def write(page, blocks):
    """Puts `blocks[name]`, lines, between `<!-- name -->` and `<!-- /name -->` of a page."""
    path = PAGES / page
    text = path.read_text()
    for name, lines in blocks.items():
        begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
        if begin not in text or end not in text:
            raise SystemExit(f"{page} has no marks {begin.strip()} and {end}")
        before, rest = text.split(begin, 1)
        after = rest.split(end, 1)[1]
        text = before + begin + "\n" + "\n".join(lines) + "\n\n" + end + after
    path.write_text(text)


def short(value, digits=2):
    """A number as people write it; a dash for none."""
    if value is None:
        return "-"
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{float(f'{value:.{digits}g}'):,.10g}"
    return f"{value:.0e}".replace("e-0", "e-").replace("e+0", "e")
