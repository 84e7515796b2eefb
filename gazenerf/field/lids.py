"""Lids over eyeballs: outside the openings between lids a face covers the eyes, and within them it does not.

A lid is thin, so where a network's distances are off by a fraction of a millimetre the eyeball comes through the skin,
or skin lies over the iris. And where the skin about an eye lies on the template a network tells to a millimetre or two,
which is enough for a lid to have the look of an eye. Both are told by the head model, at each gaze.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

EXTENT = 80.0
"""Degrees of elevation and of azimuth, to either side, that maps by direction cover."""

OVER, UNDER = 0.008, 0.02
"""World units before an eyeball's surface where a lid is at least (the cornea bulges by 0.005), and behind it where
skin within an opening is at most."""

SHUT_OVER = 0.006
"""So much further before it a lid is that is shut: an iris would shine through a thin one."""

BORDER = (-0.005, 0.01)
"""Distances from the border of an opening, world units, below which a direction is a lid's, and above which not."""

REACH = 1.7
"""Radii from an eyeball's centre within which lids are looked for."""

PLACED_RADII, PLACED_COSINES = (1.7, 2.2), (0.34, 0.6)
"""How far from an eyeball's centre, in radii, skin is placed by the head model in full and not at all; and the cosines
of the angle from straight ahead below which it is not and above which it is in full."""


class Lids(NamedTuple):
    """One person's eyeballs and lids at a gaze.

    Maps are by directions from an eyeball's centre: rows by elevation from low to high, columns by azimuth towards the
    subject's left, both as far as `EXTENT`.

    Attributes:
        centres: (2, 3) of the eyeballs, the subject's left first, world units.
        openings: (2, 1, N, N) signed distance from the border of each opening along the eyeball's surface, world units,
            positive within it.
        skins: (2, 2, 5, N, N) of each eye the first and the last skin in each direction, mostly the same, but there are
            folds, and a pit at the inner corner: their places on the template, their distances from the eyeball's
            centre, world units, and how much they count: 0 where they are not known, 1 where lids are lowered or shut.
        shut: (2,) how far each eye is shut by the expression, 0 to 1: of eyes that are, the lids are thicker.
        radius: () of the eyeballs, world units.
    """

    centres: torch.Tensor
    openings: torch.Tensor
    skins: torch.Tensor
    shut: torch.Tensor
    radius: torch.Tensor

    def to(self, device: torch.device | str) -> Lids:
        """The same on a device."""
        return Lids(*(part.to(device) for part in self))

    @staticmethod
    def mean(of: Sequence[Lids], weights: Sequence[float]) -> Lids:
        """Between lids at several gazes: their weighted sum; weights add up to 1."""
        if len(of) == 1:
            return of[0]
        shares = torch.tensor(weights)
        return Lids(*(torch.tensordot(shares, torch.stack(parts), 1) for parts in zip(*of, strict=True)))

    def placed(self, places: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        """Places (B, N, 3) on the template of points (B, N, 3): of skin about eyes those of the head model.

        Args:
            places: As a network gives them.
            points: World units.
        """
        away, eye = self._nearest(points)
        full, none = (radii * self.radius for radii in PLACED_RADII)
        counts = self.skins[:, :, 4].flatten(1).amax(dim=1) > 0.0
        near = ((away < none) & counts[eye]).nonzero(as_tuple=True)
        if not len(near[0]):
            return places
        eye, away = eye[near], away[near]
        local = points[near] - self.centres[eye]
        border, skins = (_by_direction(maps, local, eye) for maps in (self.openings, self.skins.flatten(1, 2)))
        first, last = skins.split(5, dim=1)
        nearer = (first[:, 3] - away).abs() <= (last[:, 3] - away).abs()
        own = torch.where(nearer[:, None], first, last)
        ahead = local[:, 2] / away.clamp(min=1e-6)
        share = _step(none, full, away) * _step(*PLACED_COSINES, ahead) * _step(BORDER[1], BORDER[0], border[:, 0])
        share = share * own[:, 4]
        return places.index_put(near, torch.lerp(places[near], own[:, :3], share[:, None]))

    def over(self, distance: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        """Signed distances from a face whose lids lie over its eyeballs, and whose openings are open.

        Args:
            distance: (B, N) as a network gives them, world units.
            points: (B, N, 3).
        """
        away, eye = self._nearest(points)
        near = (away < REACH * self.radius).nonzero(as_tuple=True)
        if not len(near[0]):
            return distance
        eye, outside, old = eye[near], away[near] - self.radius, distance[near]
        local = points[near] - self.centres[eye]
        border = _by_direction(self.openings, local, eye)[:, 0]
        covered = torch.minimum(old, outside - OVER - SHUT_OVER * self.shut[eye])
        opened = torch.maximum(old, outside + UNDER)
        found = torch.where(border < BORDER[0], covered, torch.where(border > BORDER[1], opened, old))
        return distance.index_put(near, torch.where(local[:, 2] > 0.0, found, old))

    def _nearest(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Distances (B, N) of points (B, N, 3) from the nearer eyeball's centre, and which one (B, N) that is."""
        away, eye = (points[..., None, :] - self.centres).norm(dim=-1).min(dim=-1)
        return away, eye


def _step(none: float | torch.Tensor, full: float | torch.Tensor, values: torch.Tensor) -> torch.Tensor:
    """(N,) 0 at `none`, 1 at `full`, linear between."""
    return ((values - none) / (full - none)).clamp(0.0, 1.0)


def _by_direction(maps: torch.Tensor, local: torch.Tensor, eye: torch.Tensor) -> torch.Tensor:
    """(N, C) values of the map (2, C, N, N) of each eye (N,) in the directions of points (N, 3) from its centre."""
    level = local[:, [0, 2]].norm(dim=-1)
    angles = torch.stack([torch.atan2(local[:, 0], local[:, 2]), torch.atan2(local[:, 1], level)], dim=-1)
    grid = (angles / np.deg2rad(EXTENT)).expand(2, 1, -1, 2)
    each = F.grid_sample(maps, grid, mode="bilinear", padding_mode="border", align_corners=True)[:, :, 0]
    return each.permute(0, 2, 1).gather(0, eye[None, :, None].expand(1, -1, maps.shape[1]))[0]
