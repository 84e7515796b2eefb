"""Heads for what is to look the same from everywhere."""

from __future__ import annotations

from gazenerf.heads.baked import BakedHead
from gazenerf.heads.head import Head
from gazenerf.heads.interface import HeadField


def without_highlights(head: HeadField) -> HeadField:
    """A head whose eyes mirror no light, see `Head.without_highlights`; of heads of other kinds they never do."""
    if isinstance(head, BakedHead):
        return BakedHead(head.head.without_highlights(), head.baked, head.hasty)
    return head.without_highlights() if isinstance(head, Head) else head
