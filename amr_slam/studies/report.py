"""What a study says: sections of text, tables and figures, written as one Markdown page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from amr_slam.pictures import style


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """Cells as they are to be read; every row has one cell a column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"{self.title}: a row of {len(row)} cells: {row}")

    def markdown(self) -> str:
        lines = [f"**{self.title}**", ""]
        lines.append("| " + " | ".join(self.columns) + " |")
        lines.append("|" + "---|" * len(self.columns))
        lines += ["| " + " | ".join(row) + " |" for row in self.rows]
        return "\n".join(lines)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Picture:
    """A figure with the file name (without suffix) under which the page shows it."""

    name: str
    caption: str
    figure: Figure


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Section:
    """One study's result."""

    title: str
    text: str
    """Markdown: what was done with how many trials, and what stands out, failures included."""
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How much is measured: 1 is the published page, less is a quick look."""

    scale: float = 1.0
    seed: int = 0
    workers: int = 1
    """Processes that share the work, where a study can be shared."""
    progress: Callable[[str], None] = print

    def trials(self, full: int, least: int = 1) -> int:
        """``full`` trials at scale 1, fewer in proportion, never fewer than ``least``."""
        return max(least, round(self.scale * full))


def write_page(title: str, preface: str, sections: Sequence[Section], path: Path) -> None:
    """The page at ``path``, its pictures as PNG files in ``images/`` beside it."""
    images = path.parent / "images"
    images.mkdir(parents=True, exist_ok=True)
    parts = [f"# {title}", preface]
    for section in sections:
        parts += [f"## {section.title}", section.text]
        parts += [table.markdown() for table in section.tables]
        for picture in section.pictures:
            style.save(picture.figure, images / f"{picture.name}.png")
            parts.append(f"![{picture.caption}](images/{picture.name}.png)\n\n*{picture.caption}*")
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
