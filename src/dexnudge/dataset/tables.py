"""A small table of texts, written for a terminal or as Markdown."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Rows of cells under a header; the first column is text, so are the others unless `numeric`. A row may be short."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: bool = True

    def text(self) -> str:
        """Columns aligned by spaces; the title stands over the first column."""
        lines = [(self.title, *self.header[1:]), *self.rows]
        widths = [max(len(line[k]) for line in lines if k < len(line)) for k in range(max(map(len, lines)))]
        aligned = (
            "  ".join(cell.rjust(widths[k]) if k else cell.ljust(widths[k]) for k, cell in enumerate(line))
            for line in lines
        )
        return "\n".join(line.rstrip() for line in aligned) + "\n"

    def markdown(self) -> str:
        """A table in GitHub's Markdown."""
        width = len(self.header)
        lines = [self.header, ("---", *["---:" if self.numeric else "---"] * (width - 1))]
        lines += [(*row, *[""] * (width - len(row))) for row in self.rows]
        return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines) + "\n"
