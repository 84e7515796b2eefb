"""Blocks become HTML that holds every text as text."""

from __future__ import annotations

import html
import re
from pathlib import Path

import numpy as np
import pytest

from gazenerf.viz.report import page
from gazenerf.viz.report.blocks import (
    Beyond,
    Block,
    ChangeFamily,
    ChangeRow,
    Changes,
    Concern,
    Concerns,
    Family,
    Fold,
    Gallery,
    Group,
    Items,
    Key,
    MeasureRow,
    Measures,
    Page,
    Picture,
    Pill,
    Pills,
    Section,
    Slider,
    Table,
    Text,
)
from gazenerf.viz.report.page import chart, photograph, render
from gazenerf.viz.report.plots import bars, scatter
from gazenerf.viz.report.readable import clauses, degrees, listed, number

HOSTILE = "<script>alert('1')</script>\" onload=\"x & {{ 123 * 1000 }}"


def every_block(text: str) -> tuple[Block, ...]:
    """One of each kind with the text wherever a text goes."""
    pill = Pill("warn", text)
    row = MeasureRow(text, text, text, text, text, text, pill, text, text)
    change = ChangeRow(text, text, text, text, text, text, text, text, pill)
    points = {text: (np.arange(2.0), np.arange(2.0)), text + "2": (np.arange(2.0), np.arange(2.0))}
    plots = (scatter(points, text, text, text), bars([text], [1.0], text, text, 2.0))
    return (
        Text(text),
        Items((text,)),
        Gallery((Picture(text, text), Slider(text, text, text, text, text), *plots)),
        Table((text, text), ((text, text),)),
        Key(text, text, text),
        Fold(text, (Text(text),)),
        Group(text, (Text(text),)),
        Pills((pill,)),
        Concerns((Concern(pill, (Beyond(text, text, text),), text),)),
        Measures((Family(text, (pill,), True, (row,), True),)),
        Changes((ChangeFamily(text, (pill,), True, (change,)),)),
    )


def page_of(text: str) -> str:
    """A page with the text in every place."""
    return render(Page(text, text, text, text, "warn", every_block(text), (Section(text, every_block(text)),)))


def test_no_text_becomes_markup_or_a_template():
    plain, hostile = page_of("harmless"), page_of(HOSTILE)
    assert "<script>alert" not in hostile and 'onload="x' not in hostile and "123000" not in hostile
    assert hostile.count("<") == plain.count("<"), "a text adds no tag"
    assert html.unescape(hostile).count(HOSTILE) == plain.count("harmless") - 2, "all but the section's anchor and link"


def test_python_holds_no_markup_and_no_template_lets_text_through_unescaped():
    folder = Path(page.__file__).parent
    tag = re.compile(r"</?(p|div|span|b|ul|li|table|tr|t[hd]|h\d|figure|img|section|details|svg|text|line|a)\b[^`]*>")
    found = [path.name for path in folder.glob("*.py") if tag.search(path.read_text())]
    assert not found, found
    templates = list((folder / "templates").glob("*.html"))
    assert len(templates) == 3
    assert not [path.name for path in templates if re.search(r"\|\s*safe|autoescape", path.read_text())]


def test_sections_are_in_the_table_of_contents_and_folded_blocks_open_on_a_click():
    text = render(Page("t", "q", "a", "Yes.", "pass", (), (Section("What is left, out?", (Fold("more", ()),)),)))
    assert '<a href="#what-is-left-out">What is left, out?</a>' in text
    assert '<section id="what-is-left-out">' in text and "<details><summary>more</summary>" in text


def test_pictures_are_inside_the_page():
    picture = np.zeros((4, 6, 3), np.uint8)
    assert photograph(picture).startswith("data:image/jpeg;base64,")
    assert chart(picture).startswith("data:image/png;base64,")


@pytest.mark.parametrize(
    ("value", "unit", "said"),
    [
        (float("nan"), "mm", "not measured"), (None, "", "not measured"), (0.00123, "mm", "0.0012 mm"),
        (0.5, "mm", "0.500 mm"), (1.5, "mm", "1.50 mm"), (1.5, "", "1.500"), (27.44, "dB", "27.4 dB"),
        (150.0, "mm²", "150 mm²"), (12345.0, "", "12,345"), (0.0, "px", "0 px"),
    ],
)  # fmt: skip
def test_numbers_have_about_three_digits(value, unit, said):
    assert number(value, unit) == said


def test_lists_and_angles_read_as_in_a_sentence():
    assert listed(["a"]) == "a" and listed(["a", "b", "c"]) == "a, b and c"
    assert clauses(["a is", "b is"]) == "a is, and b is"
    assert degrees(-30.2) == "-30°" and number(1.5, "mm", bare=True) == "1.50"
