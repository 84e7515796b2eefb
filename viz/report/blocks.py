"""What a page is made of, as plain data; the templates lay it out and escape every text."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import ClassVar


@dataclass(frozen=True)
class Text:
    """A paragraph; quiet ones explain, others say something."""

    kind: ClassVar[str] = "text"
    text: str
    quiet: bool = True


@dataclass(frozen=True)
class Items:
    """A list of sentences."""

    kind: ClassVar[str] = "items"
    texts: tuple[str, ...]


@dataclass(frozen=True)
class Picture:
    """A picture with its caption.

    Attributes:
        source: Data URI.
        caption: Below the picture; also its alternative text.
        crisp: Enlarged without smoothing.
    """

    kind: ClassVar[str] = "picture"
    source: str
    caption: str
    crisp: bool = False


@dataclass(frozen=True)
class Slider:
    """Two pictures of one size: side by side, or one over the other under a slider where scripts run.

    Attributes:
        left, right: Data URIs.
        left_name, right_name: What they show.
        caption: Below both.
    """

    kind: ClassVar[str] = "slider"
    left: str
    right: str
    left_name: str
    right_name: str
    caption: str


@dataclass(frozen=True)
class Mark:
    """A tick of an axis, or a line across a plot: its place in pixels of the plot and its label."""

    at: float
    label: str


@dataclass(frozen=True)
class Dot:
    """A point of a scatter plot, pixels of the plot; `label` is shown on hovering."""

    x: float
    y: float
    label: str


@dataclass(frozen=True)
class Series:
    """Points of one colour."""

    name: str
    colour: str
    dots: tuple[Dot, ...]


@dataclass(frozen=True)
class Scatter:
    """Measured against commanded: points, and the line on which both are equal.

    Attributes:
        width, height: Of the plot, pixels.
        left, right, top, bottom: Edges of the frame inside it.
        equal: (x1, y1, x2, y2) of the line.
    """

    kind: ClassVar[str] = "scatter"
    title: str
    x_label: str
    y_label: str
    width: int
    height: int
    left: int
    right: int
    top: int
    bottom: int
    x_ticks: tuple[Mark, ...]
    y_ticks: tuple[Mark, ...]
    series: tuple[Series, ...]
    equal: tuple[float, float, float, float]


@dataclass(frozen=True)
class Bar:
    """One bar: its name, the pixels of its middle and its length, and what it says on hovering."""

    name: str
    y: float
    length: float
    label: str


@dataclass(frozen=True)
class Bars:
    """Horizontal bars from zero, with the threshold that holds for what they show.

    Attributes:
        width, height: Of the plot, pixels.
        left, right, top, bottom: Edges of the bars' area inside it.
        limit: A dashed line, None where it lies beyond the plot or there is none.
    """

    kind: ClassVar[str] = "bars"
    title: str
    x_label: str
    width: int
    height: int
    left: int
    right: int
    top: int
    bottom: int
    ticks: tuple[Mark, ...]
    bars: tuple[Bar, ...]
    limit: Mark | None


@dataclass(frozen=True)
class Gallery:
    """Pictures, sliders and plots side by side.

    Attributes:
        items: In reading order.
        layout: `strip` (as many beside each other as fit, small), `pair` (two, one on a phone), `three` or `four`.
    """

    kind: ClassVar[str] = "gallery"
    items: tuple[Picture | Slider | Scatter | Bars | Text, ...]
    layout: str = "four"


@dataclass(frozen=True)
class Table:
    """Plain cells; the first column names the row, the others hold numbers."""

    kind: ClassVar[str] = "table"
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Key:
    """The key of a map of signed millimetres: a data URI of the colours and what their ends mean."""

    kind: ClassVar[str] = "key"
    low: str
    source: str
    high: str


@dataclass(frozen=True)
class Fold:
    """Blocks that open on a click."""

    kind: ClassVar[str] = "fold"
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Group:
    """Blocks under a small heading."""

    kind: ClassVar[str] = "group"
    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True)
class Pill:
    """A coloured word: `tone` is `pass`, `warn`, `fail` or `unmeasured`."""

    kind: ClassVar[str] = "pill"
    tone: str
    text: str


@dataclass(frozen=True)
class Pills:
    """Coloured words in a row."""

    kind: ClassVar[str] = "pills"
    pills: tuple[Pill, ...]


@dataclass(frozen=True)
class Beyond:
    """A metric beyond its threshold: its label, its value with the threshold, and what it measures."""

    label: str
    reading: str
    meaning: str


@dataclass(frozen=True)
class Concern:
    """What to do about metrics that warn or fail for one reason.

    Attributes:
        verdict: Of all of them.
        metrics: Those that share the advice.
        advice: What the warning means for the user and what to do; may be empty.
    """

    verdict: Pill
    metrics: tuple[Beyond, ...]
    advice: str


@dataclass(frozen=True)
class Concerns:
    """Everything that warns or fails, worst first."""

    kind: ClassVar[str] = "concerns"
    concerns: tuple[Concern, ...]


@dataclass(frozen=True)
class MeasureRow:
    """A metric in its table: texts as shown, `interval` empty where it is not known."""

    name: str
    label: str
    meaning: str
    value: str
    interval: str
    reference: str
    verdict: Pill
    passes: str
    warns: str


@dataclass(frozen=True)
class Family:
    """Metrics that belong together, folded unless one of them is beyond its threshold.

    Attributes:
        title: Of the family.
        pills: How many have each verdict.
        opened: Whether the family is open at first.
        rows: Its metrics.
        with_reference: Whether two renders of the reference were compared by one of them.
    """

    title: str
    pills: tuple[Pill, ...]
    opened: bool
    rows: tuple[MeasureRow, ...]
    with_reference: bool


@dataclass(frozen=True)
class Measures:
    """Every metric by family."""

    kind: ClassVar[str] = "measures"
    families: tuple[Family, ...]


@dataclass(frozen=True)
class ChangeRow:
    """A metric of two runs, as shown."""

    name: str
    label: str
    meaning: str
    first: str
    first_interval: str
    second: str
    second_interval: str
    change: str
    judgement: Pill


@dataclass(frozen=True)
class ChangeFamily:
    """Metrics of two runs that belong together."""

    title: str
    pills: tuple[Pill, ...]
    opened: bool
    rows: tuple[ChangeRow, ...]


@dataclass(frozen=True)
class Changes:
    """Every metric of two runs by family."""

    kind: ClassVar[str] = "changes"
    families: tuple[ChangeFamily, ...]


Block = (
    Text | Items | Picture | Slider | Scatter | Bars | Gallery | Table | Key | Fold | Group | Pills | Concerns
    | Measures | Changes
)  # fmt: skip


@dataclass(frozen=True)
class Section:
    """Blocks under a heading that the table of contents names."""

    title: str
    blocks: tuple[Block, ...]

    @property
    def anchor(self) -> str:
        """The heading as a link's target."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


@dataclass(frozen=True)
class Page:
    """A whole page.

    Attributes:
        title: Of the window.
        question: The heading.
        about: What was looked at.
        answer: The heading's answer in one sentence, coloured by its tone.
        tone: `pass`, `warn`, `fail` or `unmeasured`.
        opening: Pictures and counts, before the table of contents.
        sections: The rest.
    """

    title: str
    question: str
    about: str
    answer: str
    tone: str
    opening: tuple[Block, ...] = ()
    sections: tuple[Section, ...] = field(default=())
