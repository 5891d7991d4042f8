"""A description in sections with two faces: a Markdown card, and the body of an HTML page."""

from dataclasses import dataclass
from html import escape
from typing import Literal

Cell = int | float | str


@dataclass(frozen=True)
class Table:
    """Rows of cells under a header; the first cell of each row is its label.

    Numbers are shown to six digits: round them to what is meaningful. chart: how a page may draw the table.
    """

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    chart: Literal["", "bars", "ranges"] = ""

    def row(self, label: str) -> dict[str, Cell]:
        """Return the cells of the row with this label by column."""
        cells = next(row for row in self.rows if row[0] == label)
        return dict(zip(self.header[1:], cells[1:], strict=True))

    def markdown(self) -> str:
        """Return a table in GitHub's Markdown."""
        numeric = [any(not isinstance(row[k], str) for row in self.rows) for k in range(len(self.header))]
        rules = ["---:" if is_numeric else "---" for is_numeric in numeric]
        lines = [self.header, rules, *self._shown()]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"

    def html(self) -> str:
        """Return a table that scrolls sideways; the title stands over the first column."""
        header = "".join(f"<th>{escape(cell)}</th>" for cell in (self.title, *self.header[1:]))
        rows = "".join(
            "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in self._shown()
        )
        return f'<div class="scroll"><table><thead><tr>{header}</tr></thead>\n<tbody>\n{rows}</tbody></table></div>\n'

    def _shown(self) -> list[list[str]]:
        return [[cell if isinstance(cell, str) else f"{cell:g}" for cell in row] for row in self.rows]


@dataclass(frozen=True)
class Section:
    """Blocks of Markdown (a paragraph, a list, or fenced code) and tables under a title."""

    title: str
    parts: tuple[str | Table, ...]


@dataclass(frozen=True)
class Document:
    """A title, one line that sums it up, and sections."""

    title: str
    summary: str
    sections: tuple[Section, ...]

    @property
    def tables(self) -> list[Table]:
        """All tables, in order."""
        return [part for section in self.sections for part in section.parts if isinstance(part, Table)]

    def markdown(self) -> str:
        """Return everything as GitHub's Markdown."""
        blocks = [f"# {self.title}\n", self.summary + "\n"]
        for section in self.sections:
            blocks.append(f"## {section.title}\n")
            for part in section.parts:
                title = f"{part.title}:\n\n" if isinstance(part, Table) and part.title else ""
                blocks.append(title + part.markdown() if isinstance(part, Table) else part + "\n")
        return "\n".join(blocks)

    def html(self) -> str:
        """Return the sections as a part of a page; text is escaped."""
        blocks = []
        for section in self.sections:
            blocks.append(f"<h2>{escape(section.title)}</h2>")
            blocks += [part.html() if isinstance(part, Table) else _block_html(part) for part in section.parts]
        return "\n".join(blocks)


def _block_html(block: str) -> str:
    """One block of Markdown: fenced code, a list, or a paragraph."""
    if block.startswith("```"):
        return f"<pre>{escape(block.partition(chr(10))[2].removesuffix('```'))}</pre>"
    if block.startswith("- "):
        return "<ul>" + "".join(f"<li>{escape(line[2:])}</li>" for line in block.split("\n")) + "</ul>"
    return f"<p>{escape(block)}</p>"
