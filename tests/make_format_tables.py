"""Fill in what `docs/format.md` shows of the code: the tables of reasons, and a small file in hexadecimal.

Run as ``python tests/make_format_tables.py`` after `make_fixture`; tests say when it must be.
"""

from __future__ import annotations

import re
from pathlib import Path

from hmkcta.hmkfile import REASONS, WRITER_REASONS, Reason
from make_fixture import FIXTURES

TEXT = Path(__file__).parent.parent / "docs" / "format.md"


def table(reasons: dict[str, Reason]) -> str:
    """Rows of a table of reasons."""
    head = "| reason | kind | meaning |\n| --- | --- | --- |\n"
    return head + "".join(
        f"| `{code}` | {reason.kind.value[0]} | {reason.sentence} |\n" for code, reason in reasons.items()
    )


def dump(data: bytes) -> str:
    """Bytes in hexadecimal with the characters that they are, 16 a line."""
    lines: list[str] = []
    for at in range(0, len(data), 16):
        part = data[at : at + 16]
        shown = "".join(chr(byte) if 32 <= byte < 127 else "." for byte in part)
        lines.append(f"{at:04x}  {part.hex(' '):47}  {shown}")
    return "```text\n" + "\n".join(lines) + "\n```\n"


def write_tables() -> None:
    """Put all of it in its place."""
    text = TEXT.read_text(encoding="utf-8")
    first, second = (table(reasons).replace("\\", "\\\\") for reasons in (REASONS, WRITER_REASONS))
    tables = iter((first, second))
    text = re.sub(
        r"\| reason \| kind \| meaning \|\n(\|.*\n|REASONS\n|WRITERS\n)*",
        lambda _: next(tables).replace("\\\\", "\\"),
        text,
    )
    hexadecimal = dump((FIXTURES / "v1-small.hmk").read_bytes())
    text = re.sub(
        r"```text\n0000 .*?```\n|^HEX\n", lambda _: hexadecimal, text, count=1, flags=re.DOTALL | re.MULTILINE
    )
    TEXT.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write_tables()
