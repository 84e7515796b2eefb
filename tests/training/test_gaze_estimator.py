"""The gaze estimator learns, resumes, is stored safely and passes gradients to pictures."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from gazenerf.errors import UserError
from gazenerf.training import gaze_training
from gazenerf.training.gaze_estimator import (
    BUNDLED,
    GazeEstimator,
    estimate_gaze,
    load_gaze_estimator,
    save_gaze_estimator,
)
from gazenerf.training.gaze_training import EstimatorData, gaze_errors, train_gaze_estimator

from .conftest import EYES, toy_capture


@pytest.fixture(scope="module")
def toy_data() -> EstimatorData:
    return EstimatorData.of([toy_capture(0, view, 64) for view in range(12)], lambda capture: EYES)


def test_the_targets_point_at_the_eyes(toy_data):
    captures = [toy_capture(0, view, 64) for view in range(12)]
    left = np.argwhere(captures[0].parts == 2).mean(0)[::-1] + 0.5
    np.testing.assert_allclose((toy_data.eyes[0, 0].numpy() + 1.0) * 32.0, left, atol=3.0)
    np.testing.assert_allclose(toy_data.gaze[0], captures[0].gaze.label)
    assert toy_data.images.shape[1:] == (3, 512, 512)


def test_turned_pictures_show_the_eyes_where_they_are_said_to_be() -> None:
    torch.manual_seed(0)
    side, margin, window, count = 96, 10, (64, 96), 16
    eyes = torch.tensor([[0.3, -0.2], [-0.35, -0.1]]).expand(count, -1, -1)
    x = (torch.arange(side) + 0.5) * 2.0 / side - 1.0

    def dot(places: torch.Tensor) -> torch.Tensor:
        away = (x - places[..., :1]).square()[..., None, :] + (x - places[..., 1:]).square()[..., None]
        return (-away / 0.003).exp()

    small = dot(eyes).sum(dim=1)[:, None].expand(-1, 3, -1, -1)
    rows, columns = window[0] + 2 * margin, window[1] + 2 * margin
    across = (torch.arange(columns) - columns / 2.0 + 0.5).abs()
    bar = ((torch.arange(rows) - rows / 2.0 + 0.5)[:, None].abs() < 2.0) & (across < 20.0)
    around = bar.float().expand(count, 2, 3, rows, columns)
    pictures, windows, found = gaze_training._moved(small, around, eyes, window, margin)
    np.testing.assert_allclose(pictures[:, 0], dot(found).sum(dim=1), atol=0.08)
    turn = torch.atan2(*(found[:, 0] - found[:, 1]).flip(1).T) - torch.atan2(torch.tensor(-0.1), torch.tensor(0.65))
    assert turn.abs().max() > np.deg2rad(3.0) and turn.abs().max() < np.deg2rad(gaze_training.TURN)
    assert windows.shape == (count, 2, 3, *window)
    for number in range(count):
        for place in windows[number, :, 0]:
            at = (place > 0.5).nonzero().double()
            middle = at.mean(dim=0) + 0.5 - torch.tensor(window) / 2.0
            assert middle.abs().max() < margin + 1.5
            direction = torch.linalg.eigh((at - at.mean(dim=0)).T @ (at - at.mean(dim=0)))[1][:, 1]
            assert torch.atan(direction[0] / direction[1]).item() == pytest.approx(float(turn[number]), abs=0.02)


def test_training_lowers_the_loss_and_resumes(toy_data, tmp_path):
    losses: list[float] = []
    state = tmp_path / "run.pt"
    settings = {"epochs": 4, "batch": 6, "learning_rate": 2e-3}

    class Killed(Exception):
        pass

    def until_two(epoch: int, loss: float, errors: object) -> None:
        losses.append(loss)
        if epoch == 2:
            raise Killed

    with pytest.raises(Killed):
        train_gaze_estimator(toy_data, {}, state=state, on_epoch=until_two, **settings)
    estimator = train_gaze_estimator(
        toy_data, {"same": toy_data}, state=state, on_epoch=lambda e, loss, r: losses.append(loss), **settings
    )
    assert len(losses) == 4 and losses[-1] < losses[0]
    assert estimator.about["held_out"]["same"]["pictures"] == 12
    with pytest.raises(UserError, match="another run"):
        train_gaze_estimator(toy_data, {}, state=state, **(settings | {"epochs": 9}))


def test_gradients_reach_the_picture_at_any_size():
    images = torch.rand(1, 3, 96, 96, requires_grad=True)
    gaze = estimate_gaze(images, GazeEstimator().eval())
    assert gaze.shape == (1, 2) and gaze.dtype == torch.float32
    gaze.sum().backward()
    assert images.grad is not None and float(images.grad.abs().sum()) > 0


def test_a_mirrored_picture_reads_as_the_mirrored_gaze():
    estimator, images = load_gaze_estimator(), torch.rand(2, 3, 512, 512, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        seen, mirrored = (estimator.read_both_ways(pictures) for pictures in (images, images.flip(3)))
        once = [estimator.read(pictures).gaze for pictures in (images, images.flip(3))]
        torch.testing.assert_close(estimator(images), seen.gaze)
    torch.testing.assert_close(mirrored.gaze, seen.gaze * torch.tensor([1.0, -1.0]), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(mirrored.eyes, seen.eyes.flip(1) * torch.tensor([-1.0, 1.0]), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(mirrored.towards, seen.towards * torch.tensor([-1.0, 1.0, 1.0]), atol=1e-5, rtol=0.0)
    assert (once[0] - once[1] * torch.tensor([1.0, -1.0])).abs().max() > 1e-3  # looked at once it does not
    torch.testing.assert_close(seen.gaze[:, 0], 0.5 * (once[0] + once[1])[:, 0])


def test_what_was_saved_comes_back(tmp_path):
    estimator = GazeEstimator().eval()
    estimator.about = {"held_out": {"a": {"mean_deg": 3.0}}}
    save_gaze_estimator(estimator, tmp_path / "g.safetensors")
    loaded = load_gaze_estimator(tmp_path / "g.safetensors")
    images = torch.rand(2, 3, 64, 64)
    with torch.no_grad():
        torch.testing.assert_close(loaded(images), estimator(images), atol=2e-3, rtol=1e-2)
    assert loaded.about == estimator.about


def test_bad_files_are_one_line(tmp_path):
    with pytest.raises(UserError, match="train one"):
        load_gaze_estimator(tmp_path / "none.safetensors")
    (tmp_path / "junk.safetensors").write_bytes(b"junk" * 20)
    with pytest.raises(UserError, match="cannot read"):
        load_gaze_estimator(tmp_path / "junk.safetensors")
    save_file({"x": torch.ones(2)}, tmp_path / "other.safetensors", {"format": "other"})
    with pytest.raises(UserError, match="format"):
        load_gaze_estimator(tmp_path / "other.safetensors")
    broken = GazeEstimator()
    broken.place.bias.data[0] = float("nan")
    save_gaze_estimator(broken, tmp_path / "nan.safetensors")
    with pytest.raises(UserError, match="NaN"):
        load_gaze_estimator(tmp_path / "nan.safetensors")


@pytest.mark.skipif(not BUNDLED.is_file(), reason="no gaze estimator is bundled")
def test_the_bundled_estimator_is_small_and_as_good_as_it_says():
    assert BUNDLED.stat().st_size < 3 * 2**20
    estimator = load_gaze_estimator()
    pytest.importorskip("pyrender")
    from gazenerf.data.protocol import plan_view
    from gazenerf.data.rasterizer import Rasterizer
    from gazenerf.data.synthesis import render_capture
    from gazenerf.head_model import load_head_model

    model = load_head_model()
    try:
        with Rasterizer((256, 256)) as rasterizer:
            views = [plan_view(model, 31337, k, 0, 256, expressions="few") for k in range(12)]
            captures = [render_capture(rasterizer, model, view) for view in views]
    except UserError as error:
        pytest.skip(str(error))
    data = EstimatorData.of(captures, lambda capture: model.eye_centres(capture.codes.identity))
    stated = estimator.about["held_out"]["held_out_people"]["mean_deg"]
    assert gaze_errors(estimator, data).mean() < 2.0 * stated + 1.0
