"""One table for every reader: a terminal or notebook, a page, a spreadsheet, a program.

    sheet = Sheet([Column("joint", left=True), Column("sd", "depth_sd", fixed(3))], records)
    console.print(sheet)
    sheet.markdown(), sheet.html(), sheet.csv(), sheet.json()

Records hold values as they are; how a value is written is decided by its column.
"""

import dataclasses
import io
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from csv import writer
from html import escape
from typing import Any

from rich import box
from rich.table import Table

NOTHING = "–"
Record = Mapping[str, Any]


def shown(value: Any) -> str:
    """A value as people read it: numbers with one decimal place, an interval `(value, low, high)`
    as ± half its width."""
    if isinstance(value, tuple):
        middle, low, high = value
        half = (high - low) / 2
        return f"{shown(middle)} ± {half:.1f}" if math.isfinite(half) else shown(middle)
    if isinstance(value, float):
        return f"{value:.1f}" if math.isfinite(value) else NOTHING
    return NOTHING if value is None else f"{value:,}" if isinstance(value, int) else str(value)


def written(form: str) -> Callable[[float | None], str]:
    """Writes a number in a form, such as "{:.1%}"; nothing where it is not known."""
    return lambda value: (
        NOTHING if value is None or not math.isfinite(value) else form.format(value)
    )


def fixed(digits: int, unit: str = "") -> Callable[[float | None], str]:
    """Writes a number with so many decimal places."""
    return written(f"{{:.{digits}f}}{unit}")


def significant(digits: int, unit: str = "") -> Callable[[float | None], str]:
    """Writes a number with so many significant digits."""
    return written(f"{{:.{digits}g}}{unit}")


def percents(interval: tuple[float, float, float]) -> str:
    """Writes a share `(value, low, high)` in whole percent, with its interval where it has one."""
    value, low, high = (100 * one for one in interval)
    return f"{value:.0f} % ({low:.0f}–{high:.0f})" if math.isfinite(low) else f"{value:.0f} %"


def signed(value: float) -> str:
    """Writes a number with its sign and two decimal places."""
    return f"{value:+.2f}".replace("-", "−")


def percent(share: float | None) -> str:
    """Writes a share in whole percent."""
    if share is None:
        return NOTHING
    return "< 1 %" if 0 < share < 0.01 else f"{100 * share:.0f} %"


def plus_minus(both: tuple[float | None, float | None]) -> str:
    """Writes a number and its standard error."""
    value, error = both
    if value is None:
        return NOTHING
    number = f"{value:.2f}".replace("-", "−")
    return number if error is None else f"{number} ± {error:.2f}"


def number(value: Any) -> float | None:
    """A number for JSON, which has no word for NaN and infinity."""
    return float(value) if math.isfinite(value) else None


@dataclasses.dataclass(frozen=True)
class Column:
    """A column of a sheet.

    Parameters
    ----------
    head
        What stands above it.
    of
        The key of what it shows, or a function of the record; by default the key is `head`.
    form
        How a value is written.
    left
        Aligned to the left, as words are. Numbers are aligned to the right.
    whole
        Never broken over two lines of a terminal.
    """

    head: str
    of: str | Callable[[Record], Any] | None = None
    form: Callable[[Any], str] = shown
    left: bool = False
    whole: bool = False

    def value(self, record: Record) -> Any:
        """What the column shows of a record."""
        if callable(self.of):
            return self.of(record)
        return record[self.head if self.of is None else self.of]


@dataclasses.dataclass(frozen=True)
class Sheet:
    """A table: `columns` that show `records`; `name` is that of its file, where it has one."""

    columns: Sequence[Column]
    records: Sequence[Record]
    title: str = ""
    caption: str = ""
    name: str = ""

    @property
    def head(self) -> list[str]:
        """What stands above the columns."""
        return [column.head for column in self.columns]

    @property
    def rows(self) -> list[list[Any]]:
        """The values shown, row by row."""
        return [[column.value(record) for column in self.columns] for record in self.records]

    def texts(self) -> list[list[str]]:
        """The values as they are written, row by row."""
        return [
            [column.form(column.value(record)) for column in self.columns]
            for record in self.records
        ]

    def only(self, heads: Iterable[str]) -> "Sheet":
        """The sheet with only the columns that have one of these heads."""
        wanted = set(heads)
        return dataclasses.replace(
            self, columns=[column for column in self.columns if column.head in wanted]
        )

    def json(self) -> list[dict[str, Any]]:
        """The records as JSON has them: None for what is not finite, an interval as an object."""
        return [{key: _plain(value) for key, value in record.items()} for record in self.records]

    def markdown(self, *, titled: bool = False) -> str:
        """The table for a page, its caption below, with `titled` its title above."""
        rule = ["---" if column.left else "---:" for column in self.columns]
        lines = "\n".join(f"| {' | '.join(line)} |" for line in [self.head, rule, *self.texts()])
        title = f"### {self.title}\n\n" if titled else ""
        return title + lines + (f"\n\n*{self.caption}*" if self.caption else "")

    def html(self) -> str:
        """The table for a page of HTML; its texts are escaped."""

        def cells(kind: str, texts: Iterable[str]) -> str:
            return "".join(
                f'<{kind} class="left">{escape(text)}</{kind}>'
                if column.left
                else f"<{kind}>{escape(text)}</{kind}>"
                for column, text in zip(self.columns, texts, strict=True)
            )

        rows = "\n".join(f"<tr>{cells('td', line)}</tr>" for line in self.texts())
        title = f"<caption>{escape(self.title)}</caption>" if self.title else ""
        note = f"<p>{escape(self.caption)}</p>" if self.caption else ""
        head = f"<thead><tr>{cells('th', self.head)}</tr></thead>"
        return f'<div class="table"><table>{title}{head}\n<tbody>{rows}</tbody></table></div>{note}'

    def csv(self) -> str:
        """The table for a spreadsheet: numbers as they are, an interval in three columns."""
        rows = self.rows
        wide = [any(isinstance(row[i], tuple) for row in rows) for i in range(len(self.columns))]

        def line(cells: Iterable[Sequence[str]]) -> list[str]:
            pairs = zip(cells, wide, strict=True)
            return [text for cell, three in pairs for text in cell[: 3 if three else 1]]

        out = io.StringIO()
        written = writer(out, lineterminator="\n")
        written.writerow(line((head, f"{head} low", f"{head} high") for head in self.head))
        written.writerows(line(map(_three, row)) for row in rows)
        return out.getvalue()

    def __rich__(self) -> Table:
        table = Table(
            title=self.title or None,
            title_justify="left",
            title_style="bold",
            caption=self.caption or None,
            caption_justify="left",
            caption_style="dim",
            box=box.SIMPLE_HEAD,
            pad_edge=False,
        )
        for column in self.columns:
            table.add_column(
                column.head,
                justify="left" if column.left else "right",
                no_wrap=column.whole,
                overflow="fold",
            )
        for row in self.texts():
            table.add_row(*row)
        return table

    def _repr_markdown_(self) -> str:
        return self.markdown(titled=bool(self.title))


def sheet_of(head: Sequence[str | Column], rows: Iterable[Sequence[Any]], **about: str) -> Sheet:
    """A sheet from rows whose first value names them.

    Parameters
    ----------
    head
        Heads of the columns, or columns; that of the first has the key `name`.
    rows
        Values in the order of `head`.
    **about
        Title, caption and name of the sheet.

    Raises
    ------
    ValueError
        Where two columns have one key, or a row is not as long as the head.
    """
    columns = [one if isinstance(one, Column) else Column(one) for one in head]
    columns[0] = dataclasses.replace(columns[0], of="name", left=True)
    keys = [str(column.of or column.head) for column in columns]
    if len(set(keys)) < len(keys):
        raise ValueError(f"two columns of one name: {', '.join(keys)}")
    return Sheet(columns, [dict(zip(keys, row, strict=True)) for row in rows], **about)


def sheet_from(rows: Iterable[Mapping[str, Any]], **about: str) -> Sheet:
    """As `sheet_of`, from rows of which each value stands under its key, the same in all of
    them."""
    listed = list(rows)
    return sheet_of(list(listed[0]), [list(row.values()) for row in listed], **about)


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return {name: _plain(part) for name, part in value._asdict().items()}  # type: ignore[attr-defined]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _three(value: Any) -> list[str]:
    """The texts of an interval for a spreadsheet; of a single value, with two empty ones."""
    parts = [*value] if isinstance(value, tuple) else [value, None, None]
    return ["" if _plain(part) is None else _digits(part) for part in parts]


def _digits(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
