"""The ResNet50 of evaluation: its weights, published ones, and what it learns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from gazenerf.errors import UserError
from gazenerf.geometry import Camera
from gazenerf.training.estimator_loop import EpochSettings, train_epochs
from gazenerf.training.estimators import estimator_name, load_view_reader
from gazenerf.training.gaze_estimator import GazeEstimator, save_gaze_estimator
from gazenerf.training.losses import gaze_vectors
from gazenerf.training.pose_estimator import (
    PoseEstimator,
    import_pose_estimator,
    load_pose_estimator,
    save_pose_estimator,
    start_from,
)
from gazenerf.training.pose_training import PoseData, augmented, moved, pose_errors, pose_loss
from gazenerf.training.resnet import ResNet

from .conftest import toy_capture

SHORT = (1, 1, 1, 1)


@pytest.fixture(scope="module")
def short() -> PoseEstimator:
    """A ResNet of one block a stage."""
    torch.manual_seed(0)
    return PoseEstimator(SHORT).eval()


def test_the_network_is_resnet50_under_the_usual_names():
    with torch.device("meta"):
        network = ResNet()
    assert sum(value.numel() for value in network.parameters()) == 23_508_032, "25,557,032 less the classifier"
    shapes = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    assert shapes["conv1.weight"] == (64, 3, 7, 7) and shapes["layer1.0.downsample.0.weight"] == (256, 64, 1, 1)
    assert shapes["layer4.2.conv3.weight"] == (2048, 512, 1, 1) and len(shapes) == 318
    assert network(torch.zeros(1, 3, 224, 224, device="meta")).shape == (1, 2048)


def test_what_was_saved_comes_back(short, tmp_path: Path):
    short.about = {"held_out": {"a": {"mean_deg": 3.0}}}
    save_pose_estimator(short, tmp_path / "p.safetensors")
    loaded = load_view_reader(tmp_path / "p.safetensors")
    assert isinstance(loaded, PoseEstimator) and loaded.about == short.about and loaded.knows_labels
    images, camera = torch.rand(2, 3, 64, 64), Camera.orbit(0.3, size=64)
    gaze, towards = loaded.read_views(images, camera)
    assert gaze.shape == (2, 2) and not gaze.requires_grad
    torch.testing.assert_close(towards.norm(dim=1), torch.ones(2))
    torch.testing.assert_close(gaze, short.read_views(images, camera)[0], atol=0.02, rtol=0.02)


def test_the_small_network_is_read_by_the_same_name(tmp_path: Path):
    save_gaze_estimator(GazeEstimator(), tmp_path / "s.safetensors")
    reader = load_view_reader(tmp_path / "s.safetensors")
    gaze, towards = reader.read_views(torch.rand(1, 3, 64, 64), Camera.neutral(64))
    assert gaze.shape == (1, 2) and towards.shape == (1, 3)
    assert isinstance(load_view_reader(), GazeEstimator)
    assert estimator_name(tmp_path / "s.safetensors").startswith("s.safetensors (")
    assert estimator_name(None).startswith("bundled (") and estimator_name(None) != estimator_name(
        tmp_path / "s.safetensors"
    )
    with pytest.raises(UserError, match="no gaze estimator at"):
        estimator_name(tmp_path / "none.safetensors")


@pytest.mark.parametrize("flat", [True, False])
def test_published_weights_load_and_know_no_labels(flat, tmp_path: Path):
    torch.manual_seed(1)
    network = PoseEstimator()
    weights = network.state_dict()
    if flat:
        weights = {name.replace("gaze_fc.0.", "gaze_fc."): value for name, value in weights.items()}
    torch.save({"epoch": 7, "model_state": {f"module.{k}": v for k, v in weights.items()}}, tmp_path / "p.pth.tar")
    loaded = load_view_reader(tmp_path / "p.pth.tar")
    assert isinstance(loaded, PoseEstimator) and not loaded.knows_labels
    torch.testing.assert_close(loaded.gaze_fc[0].weight, network.gaze_fc[0].weight)
    torch.testing.assert_close(loaded.gaze_network.layer3[5].conv2.weight, network.gaze_network.layer3[5].conv2.weight)


def test_classifiers_give_their_features(tmp_path: Path):
    torch.manual_seed(2)
    classifier = ResNet(SHORT).state_dict() | {"fc.weight": torch.ones(10, 2048), "fc.bias": torch.ones(10)}
    estimator = PoseEstimator(SHORT)
    for name, save in (("a.pth", torch.save), ("a.safetensors", save_file)):
        save(classifier, tmp_path / name)
        torch.manual_seed(3)
        estimator = PoseEstimator(SHORT)
        start_from(estimator, tmp_path / name)
        torch.testing.assert_close(estimator.gaze_network.conv1.weight, classifier["conv1.weight"])
    torch.save({"conv1.weight": torch.ones(2)}, tmp_path / "b.pth")
    with pytest.raises(UserError, match="no ResNet50 under torchvision's names"):
        start_from(estimator, tmp_path / "b.pth")


class Attack:
    def __reduce__(self):
        return print, ("executed",)


def test_bad_files_are_one_line(short, tmp_path: Path, capsys):
    path = tmp_path / "p.safetensors"
    with pytest.raises(UserError, match=r"no gaze estimator at .*train-estimator"):
        load_view_reader(path)
    path.write_bytes(b"junk" * 20)
    with pytest.raises(UserError, match="cannot read the weights"):
        load_view_reader(path)
    torch.save({"model_state": {"gaze_fc.weight": torch.ones(2, 2048)}}, path)
    with pytest.raises(UserError, match="no ResNet50 with four outputs"):
        import_pose_estimator(path)
    torch.save([1, 2], path)
    with pytest.raises(UserError, match="no named tensors"):
        import_pose_estimator(path)
    torch.save({"weights": Attack()}, path)
    with pytest.raises(UserError, match="nothing in it was executed"):
        load_view_reader(path)
    assert "executed" not in capsys.readouterr().out
    save_file({"x": torch.ones(2)}, path, {"format": "other"})
    with pytest.raises(UserError, match="format"):
        load_view_reader(path)
    save_file({"x": torch.ones(2)}, path, {"format": "gazenerf-pose-estimator-1", "blocks": "[1, 1, 1, 999]"})
    with pytest.raises(UserError, match="none of a ResNet"):
        load_pose_estimator(path)
    broken = PoseEstimator(SHORT)
    broken.gaze_fc[0].bias.data[0] = float("nan")
    save_pose_estimator(broken, path)
    with pytest.raises(UserError, match="NaN"):
        load_pose_estimator(path)


@pytest.fixture(scope="module")
def toy_data() -> PoseData:
    return PoseData.of([toy_capture(0, view, 64) for view in range(10)])


def test_training_lowers_the_loss(toy_data):
    torch.manual_seed(0)
    estimator, losses = PoseEstimator(SHORT), []
    few, device = replace(toy_data, patches=toy_data.patches[..., ::4, ::4]), torch.device("cpu")
    train_epochs(
        estimator, lambda rows: pose_loss(estimator, few, rows, device), len(few), EpochSettings(12, 5, 1e-3),
        on_epoch=lambda epoch, loss: losses.append(loss),
    )  # fmt: skip
    assert len(losses) == 12 and np.mean(losses[-2:]) < 0.7 * losses[0]


def test_mirrored_patches_have_mirrored_labels(toy_data):
    torch.manual_seed(0)
    patches, gaze, towards = augmented(toy_data, torch.arange(10))
    assert patches.shape == (10, 3, 224, 224) and float(patches.min()) >= 0.0 and float(patches.max()) <= 1.0
    turned = torch.sign(gaze[:, 1] * toy_data.gaze[:, 1])
    torch.testing.assert_close(gaze.abs(), toy_data.gaze.abs())
    torch.testing.assert_close(towards[:, 0], toy_data.towards[:, 0] * turned)
    assert set(turned.tolist()) == {-1.0, 1.0}
    vectors = gaze_vectors(gaze)
    torch.testing.assert_close(vectors[:, 0], gaze_vectors(toy_data.gaze)[:, 0] * turned)


def test_patches_move_by_whole_pixels():
    patch = torch.arange(3 * 4 * 4, dtype=torch.float32).reshape(3, 4, 4) + 1
    out = moved(patch, 1, -2)
    torch.testing.assert_close(out[:, 1:, :2], patch[:, :3, 2:])
    assert float(out[:, 0].abs().sum()) == 0.0 and float(out[:, :, 2:].abs().sum()) == 0.0
    torch.testing.assert_close(moved(patch, 0, 0), patch)


def test_errors_are_those_of_gaze_and_head(toy_data):
    class Constant(torch.nn.Module):
        def forward(self, patches):
            from gazenerf.training.pose_estimator import Pose

            return Pose(torch.zeros(len(patches), 2), torch.zeros(len(patches), 2))

    found = pose_errors(Constant(), toy_data, torch.device("cpu"), batch=4)
    straight = np.array([0.0, 0.0, 1.0])
    angles = np.rad2deg(np.arccos(gaze_vectors(toy_data.gaze).numpy() @ straight))
    assert found["mean_deg"] == pytest.approx(angles.mean(), abs=0.01) and found["pictures"] == 10
    heads = np.rad2deg(np.arccos(toy_data.towards.numpy() @ straight))
    assert found["head"]["mean_deg"] == pytest.approx(heads.mean(), abs=0.01)
