"""Lids over eyeballs: outside the openings between lids a face covers the eyes, and within them it does not.

A lid is thin, so where a network's distances are off by a fraction of a millimetre the eyeball comes through the skin,
or skin lies over the iris. Places on the template, which follow the lids when the gaze moves them, tell where an
opening is; the person's own lids, which an expression may shut, have to be apart there, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F

EXTENT = 80.0
"""Degrees of elevation and of azimuth, to either side, that maps of openings cover."""

OVER, UNDER = 0.008, 0.02
"""World units before an eyeball's surface where a lid is at least (the cornea bulges by 0.005), and behind it where
skin within an opening is at most."""

SHUT_OVER = 0.006
"""So much further before it a lid is that is shut: an iris would shine through a thin one."""

BORDER = (-0.005, 0.01)
"""Distances from the border of an opening, world units, below which a place is a lid's and above which it is not."""

REACH = 1.7
"""Radii from an eyeball's centre within which lids are looked for."""

PLACED_ANEW = (1.8, 2.4)
"""Radii from an eyeball's centre within which skin about shut eyes is placed anew, and from which on none is."""


class ShutLids(NamedTuple):
    """Where the skin about eyes that an expression shuts lies on the template.

    A network that learned from open eyes places a shut lid into the opening, where features are an eye's.

    Attributes:
        shares: (2,) how much of the places counts, 0 to 1: as much as an eye is shut.
        places: (2, 3, N, N, N) on the template, world units, along z, y, x of cubes about the eyeballs' centres; their
            sides are twice the second of `PLACED_ANEW` in radii.
    """

    shares: torch.Tensor
    places: torch.Tensor

    def to(self, device: torch.device | str) -> ShutLids:
        """The same on a device."""
        return ShutLids(self.shares.to(device), self.places.to(device))


class Lids(NamedTuple):
    """One person's eyeballs, and the openings before those of the template.

    Attributes:
        centres: (2, 3) of this person's eyeballs, the subject's left first, world units.
        template_centres: (2, 3) of the template's.
        openings: (2, 1, N, N) signed distance from the border of each opening of the template along the eyeball's
            surface, world units, positive within it, by directions from its centres: elevation from low to high, and
            azimuth towards the subject's left, as far as `EXTENT`.
        own: (2, 1, N, N) the same of this person's openings, with the eyes straight ahead.
        radius: () of the eyeballs, world units.
        shut: Where the skin about eyes that are shut lies; None where both are open.
    """

    centres: torch.Tensor
    template_centres: torch.Tensor
    openings: torch.Tensor
    own: torch.Tensor
    radius: torch.Tensor
    shut: ShutLids | None = None

    def to(self, device: torch.device | str) -> Lids:
        """The same on a device."""
        *parts, shut = self
        return Lids(*(part.to(device) for part in parts), shut=None if shut is None else shut.to(device))

    def placed(self, places: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
        """Places (B, N, 3) on the template of points (B, N, 3), those about shut eyes instead of a network's."""
        if self.shut is None:
            return places
        away, eye = self._nearest(points)
        full, none = (radii * self.radius for radii in PLACED_ANEW)
        near = ((away < none) & (self.shut.shares[eye] > 0.0)).nonzero(as_tuple=True)
        if not len(near[0]):
            return places
        eye = eye[near]
        grid = ((points[near] - self.centres[eye]) / none).expand(2, 1, 1, -1, 3)
        each = F.grid_sample(self.shut.places, grid, mode="bilinear", padding_mode="border", align_corners=True)
        own = each[:, :, 0, 0].permute(0, 2, 1).gather(0, eye[None, :, None].expand(1, -1, 3))[0]
        share = self.shut.shares[eye] * ((none - away[near]) / (none - full)).clamp(0.0, 1.0)
        return places.index_put(near, torch.lerp(places[near], own, share[:, None]))

    def over(self, distance: torch.Tensor, points: torch.Tensor, places: torch.Tensor) -> torch.Tensor:
        """Signed distances from a face whose lids lie over its eyeballs, and whose openings are open.

        Args:
            distance: (B, N) as a network gives them, world units.
            points: (B, N, 3).
            places: (B, N, 3) of the points on the template.
        """
        away, eye = self._nearest(points)
        near = (away < REACH * self.radius).nonzero(as_tuple=True)
        if not len(near[0]):
            return distance
        eye, outside, old = eye[near], away[near] - self.radius, distance[near]
        local = places[near] - self.template_centres[eye]
        border, own = _border(self.openings, local, eye), _border(self.own, points[near] - self.centres[eye], eye)
        over = OVER if self.shut is None else OVER + SHUT_OVER * self.shut.shares[eye]
        covered = torch.minimum(old, outside - over)
        opened = torch.maximum(old, outside + UNDER)
        found = torch.where(border < BORDER[0], covered, torch.where((border > BORDER[1]) & (own > 0.0), opened, old))
        return distance.index_put(near, torch.where(local[:, 2] > 0.0, found, old))

    def _nearest(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Distances (B, N) of points (B, N, 3) from the nearer eyeball's centre, and which one (B, N) that is."""
        away, eye = (points[..., None, :] - self.centres).norm(dim=-1).min(dim=-1)
        return away, eye


def _border(openings: torch.Tensor, local: torch.Tensor, eye: torch.Tensor) -> torch.Tensor:
    """(N,) distances from the border of the opening (2, 1, N, N) of each eye (N,) at places (N, 3) from its centre."""
    level = local[:, [0, 2]].norm(dim=-1)
    angles = torch.stack([torch.atan2(local[:, 0], local[:, 2]), torch.atan2(local[:, 1], level)], dim=-1)
    grid = (angles / np.deg2rad(EXTENT)).expand(2, 1, -1, 2)
    each = F.grid_sample(openings, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return each[:, 0, 0].gather(0, eye[None])[0]
