"""The report as Markdown (GitHub's flavour)."""

from __future__ import annotations

from flexfmu.cosim.paper.layout import Block, CellText, Grade, Page


def table_to_markdown(page: Page) -> str:
    """One table of the paper: every cell as paper → computed (relative error)."""
    parts = [f"## {page.label}. {page.title}", *page.remarks, *(_block(block) for block in page.blocks)]
    if page.footnotes:
        parts.append("\n".join(f"- {mark} {text}" for mark, text in page.footnotes))
    return "\n\n".join([*parts, f"**{page.summary}**"]) + "\n"


def _block(block: Block) -> str:
    lines = [
        f"**{block.name}** [{block.unit}]{block.marks}: {block.meaning}; paper → computed (relative error)",
        "",
        _line(["", *block.columns]),
        _line(["---", *("---:" for _ in block.columns)]),
        *(_line([label, *(_cell(cell) for cell in cells)]) for label, cells in block.rows),
    ]
    return "\n".join(lines)


def _cell(cell: CellText) -> str:
    paper = f"~~{cell.paper}~~" if cell.grade is Grade.MISPRINT else cell.paper
    return f"{paper} → **{cell.computed}** ({cell.difference}){cell.marks}"


def _line(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"
