"""Windows of pictures show what the whole pictures show there, and are learned from alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS
from gazenerf.field.model import TwoStreamField
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import TrainConfig
from gazenerf.training.feed import Feed
from gazenerf.training.forward import render_batch
from gazenerf.training.objective import Objective
from gazenerf.training.runtime import Runtime
from gazenerf.training.windows import MARGIN, Window, chosen_window

FIELD = replace(
    PRESETS["tiny"], image_size=32, feature_size=16, identity=4, expression=3, texture=5, illumination=27, merge="joint"
)
CONFIG = TrainConfig(
    field_preset="tiny", perceptual=0.0, perceptual_backbone="none", batch=2, shell_noise=0.0, steps=10,
    window=(8, 12), streams_every=1,
)  # fmt: skip
WINDOW = Window(8, 12)


@pytest.mark.parametrize("changes", [{}, {"merge": "max"}, {"streams": "one"}])
def test_a_window_is_that_part_of_the_whole_picture(toy_captures, changes) -> None:
    torch.manual_seed(2)
    field = TwoStreamField(replace(FIELD, **changes))
    with torch.no_grad():
        field.renderer.background_features.normal_()
    whole = BatchMaker(toy_captures, 16).batch([0, 9], np.random.default_rng(0))
    part = BatchMaker(toy_captures, 16, window=WINDOW).batch([0, 9], np.random.default_rng(0))
    two = field.config.streams == "two"
    how = {"shell": 0.1, "samples": 6, "jitter": False, "geometry": False, "face_image": two}
    everything, seen = render_batch(field, whole, **how), render_batch(field, part, **how)
    assert part.rays.shape[1] < whole.rays.shape[1] and seen.image.shape == part.image.shape == (2, 3, 16, 24)
    assert part.parts.shape == (2, 16, 24)
    inner = slice(2 * MARGIN, -2 * MARGIN)
    for number, (row, column) in enumerate((2 * part.eye_corner).tolist()):
        place = number, slice(None), slice(row, row + 16), slice(column, column + 24)
        torch.testing.assert_close(part.image[number], whole.image[place])
        pairs = [(seen.image, everything.image)]
        if two:
            assert seen.face_image is not None and everything.face_image is not None
            pairs.append((seen.face_image, everything.face_image))
        for ours, theirs in pairs:
            torch.testing.assert_close(ours[number, :, inner, inner], theirs[place][:, inner, inner], rtol=0, atol=1e-5)


def test_windows_lie_around_the_eyes_or_anywhere_on_the_head(toy_captures) -> None:
    maker = BatchMaker(toy_captures, 16)
    target = maker.targets[0]
    rng = np.random.default_rng(0)
    at_eyes = {Window(8, 12, eyes=1.0).corner(target, 16, rng) for _ in range(20)}
    anywhere = {Window(8, 12, eyes=0.0).corner(target, 16, rng) for _ in range(40)}
    (corner,) = at_eyes
    inside = Window(8, 12).within(target, corner, 16)
    assert inside.eyes_coverage.sum() == pytest.approx(target.eyes_coverage.sum()), "both eyes are in it"
    assert np.all(np.isin(inside.rays[inside.eye_rays], target.rays[target.eye_rays]))
    assert len(anywhere) > 5 and all(0 <= row <= 8 and 0 <= column <= 4 for row, column in anywhere)


def test_windows_around_the_mouth_show_what_lies_below_the_eyes(toy_captures) -> None:
    maker = BatchMaker(toy_captures, 16)
    rng = np.random.default_rng(0)
    for target, capture in zip(maker.targets, maker.captures, strict=True):
        if target.mouth < 0:
            assert capture.camera.position[2] < 1.0
            continue
        eyes = target.rays[target.eyes_coverage > 0] // 16
        assert not eyes.size or target.mouth // 16 > eyes.max()
        row, column = Window(4, 6, eyes=0.0, mouth=1.0).corner(target, 16, rng)
        assert row <= target.mouth // 16 < row + 4 and column <= target.mouth % 16 < column + 6
    assert sum(target.mouth >= 0 for target in maker.targets) > len(maker.targets) // 2
    nowhere = replace(maker.targets[0], mouth=-1)
    assert len({Window(4, 6, eyes=0.0, mouth=1.0).corner(nowhere, 16, rng) for _ in range(20)}) > 5


def test_what_lies_along_a_windows_edges_does_not_count(toy_captures) -> None:
    maker = BatchMaker(toy_captures, 16, window=WINDOW)
    batch = maker.batch([0, 9], np.random.default_rng(0))
    objective = Objective(TwoStreamField(FIELD), CONFIG, 16)
    torch.manual_seed(0)
    first, _ = objective(batch, 0)
    edge = 2 * MARGIN
    for name, changed in (("edge", slice(0, edge)), ("middle", slice(edge, edge + 2))):
        image = batch.image.clone()
        image[:, :, changed] = 1.0 - image[:, :, changed]
        torch.manual_seed(0)
        loss, parts = objective(replace(batch, image=image), 0)
        assert (abs((loss - first).item()) < 1e-6) == (name == "edge"), name
        assert {"whole", "eyes_merged", "face", "eyes"} <= parts.keys()


def test_windows_stay_in_main_memory_and_whole_pictures_need_none(toy_captures) -> None:
    feed = Feed(BatchMaker(toy_captures, 16, window=WINDOW), CONFIG, Runtime("cpu"))
    assert feed.held == "host" and feed.at(0)[1].window == (8, 12)
    assert chosen_window(replace(CONFIG, window=None), FIELD) is None
    assert chosen_window(CONFIG, FIELD) == WINDOW
    with pytest.raises(UserError, match=r"\[8, 20\] is larger than the feature map of 16x16"):
        chosen_window(replace(CONFIG, window=(8, 20)), FIELD)


@pytest.mark.parametrize("window", [[4, 12], [8], 8, [8.5, 12], "8x12", [8, True]])
def test_windows_that_are_none(window) -> None:
    with pytest.raises(ValueError, match=r"window must be \[height, width\]"):
        TrainConfig.from_dict({"window": window})
    with pytest.raises(ValueError, match="window_eyes"):
        TrainConfig.from_dict({"window": [8, 12], "window_eyes": 1.5})
    with pytest.raises(ValueError, match="window_mouth"):
        TrainConfig.from_dict({"window": [8, 12], "window_eyes": 0.6, "window_mouth": 0.5})
    assert TrainConfig.from_dict({"window": [8, 12]}).window == (8, 12)
