from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.geometry import Camera, Gaze
from gazenerf.viz.pictures.sheets import contact_sheet, gaze_grid

SIZE = 24


class Flat:
    """A field whose picture is one colour that encodes gaze (red pitch, green yaw) and camera yaw (blue)."""

    def __init__(self, gaze: Gaze) -> None:
        self.gaze = gaze

    def render(self, camera, parts=("head",)):
        around = Gaze.from_vector(camera.position).yaw
        colour = np.float32([0.5 + self.gaze.pitch, 0.5 + self.gaze.yaw, 0.5 + 0.2 * around])
        return SimpleNamespace(image=np.broadcast_to(colour, (camera.height, camera.width, 3)))


class FlatHead:
    """A head of that colour, which counts its gazes."""

    device = torch.device("cpu")

    def __init__(self) -> None:
        self.gazes = []

    def at(self, gaze):
        self.gazes.append(gaze)
        return Flat(gaze)


def tiles(sheet: np.ndarray, rows: int, columns: int, size: int = SIZE) -> np.ndarray:
    """(rows, columns, 3) colours at the tiles' centres."""
    y = sheet.shape[0] - rows * (size + 4) + np.arange(rows) * (size + 4) + size // 2
    x = sheet.shape[1] - columns * (size + 4) + np.arange(columns) * (size + 4) + size // 2
    return sheet[np.ix_(y, x)].astype(int)


def test_a_gaze_grid_has_up_on_top_and_the_subjects_left_at_the_right():
    told = []
    sheet = gaze_grid(
        FlatHead(), Camera.neutral(SIZE), [-0.2, 0.0, 0.2], [0.3, -0.3], progress=lambda *step: told.append(step)
    )
    colours = tiles(sheet, 3, 2)
    np.testing.assert_allclose(colours[:, 0, 0], np.array([0.7, 0.5, 0.3]) * 255, atol=1)
    np.testing.assert_allclose(colours[0, :, 1], np.array([0.2, 0.8]) * 255, atol=1)
    assert [done for _, done, total in told] == [1, 2, 3, 4, 5, 6] and {total for *_, total in told} == {6}


def test_a_crop_keeps_that_part_of_every_tile():
    whole = gaze_grid(FlatHead(), Camera.neutral(SIZE), [0.0], [0.0])
    strip = gaze_grid(FlatHead(), Camera.neutral(SIZE), [0.0], [0.0], crop=(0, 6, SIZE, 18))
    assert whole.shape[0] - strip.shape[0] >= 12


def test_a_contact_sheet_has_gazes_down_and_views_across():
    head = FlatHead()
    gazes = [Gaze(0.1, 0.0), Gaze(-0.1, 0.2)]
    cameras = [Camera.orbit(yaw, size=SIZE) for yaw in (-1.0, 0.0, 1.0)]
    colours = tiles(contact_sheet(head, cameras, gazes), 2, 3)
    np.testing.assert_allclose(colours[:, 0, 0], np.array([0.6, 0.4]) * 255, atol=1)
    np.testing.assert_allclose(colours[1, :, 2], np.array([0.3, 0.5, 0.7]) * 255, atol=1)
    assert head.gazes == gazes


def test_empty_sheets_are_refused():
    with pytest.raises(UserError, match="at least one pitch"):
        gaze_grid(FlatHead(), Camera.neutral(8), [], [0.0])
    with pytest.raises(UserError, match="at least one view"):
        contact_sheet(FlatHead(), [], [Gaze()])
