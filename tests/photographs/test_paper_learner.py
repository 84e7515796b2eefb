"""The paper's inference learns the masked photograph alone, on every kind of field, and a subject carries all of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from gazenerf.data.captures import Capture
from gazenerf.errors import UserError
from gazenerf.field.config import PAPER
from gazenerf.field.model import TwoStreamField
from gazenerf.geometry import Camera, Gaze
from gazenerf.heads import Head
from gazenerf.personal_weights import PersonalWeights
from gazenerf.photographs.fine_tuning import learn
from gazenerf.photographs.masked_comparison import MaskedComparison
from gazenerf.photographs.paper_learner import PaperLearner, learned_names, near_mask
from gazenerf.photographs.tuning import Tuning
from gazenerf.subjects import Subject
from gazenerf.training.losses import perceptual_loss
from gazenerf.training.ray_targets import ray_targets
from tests.field_doubles import make_field, make_subject, tiny_config

PUBLISHED = {
    "merge": "max", "sampler": "slabs", "background": "ones", "density_activation": "relu", "ray_offset": 0.0,
    "gaze_label_signs": (-1.0, -1.0), "input_gains": (1.0, 1.0, 1.0, 1.0, 1.0),
}  # fmt: skip
KINDS = {
    "joint": {},
    "published": PUBLISHED,
    "one stream": {"streams": "one", "eye_motion": "none", "merge": "max", "sampler": "slabs"},
}


def features(images: torch.Tensor) -> list[torch.Tensor]:
    """Instead of VGG16."""
    return [images, F.avg_pool2d(images, 2)]


def looked_at(images: torch.Tensor) -> torch.Tensor:
    """Instead of the gaze estimator."""
    return images.mean((2, 3))[:, :2] - 0.3


def capture(subject: Subject, gaze: Gaze = Gaze(0.1, -0.2)) -> Capture:  # noqa: B008
    """A disc of a colour with two eyes, on black."""
    camera = Camera.neutral(32)
    rows, columns = np.mgrid[:32, :32] - 15.5
    parts = (np.hypot(rows, columns) < 9).astype(np.uint8)
    parts[12:15, 10:13], parts[12:15, 19:22] = 3, 2
    image = np.where(parts[..., None] > 0, np.array([200, 140, 90]), 0).astype(np.uint8)
    image[parts > 1] = 240
    depth = np.where(parts > 0, 11.0, 0.0).astype(np.float32)
    return Capture(image, parts, depth, camera, gaze, subject.codes, 0, 0)


def inside(picture: np.ndarray, item: Capture) -> float:
    return float(np.abs(picture - item.image / 255.0)[item.head_mask].mean())


@pytest.mark.parametrize("kind", KINDS)
def test_the_masked_photograph_is_learned_and_the_subject_draws_it(kind: str) -> None:
    field = make_field(tiny_config(**KINDS[kind]))
    subject = make_subject(field.config)
    item, tuning = capture(subject), Tuning("short", "paper", steps=8)
    untouched = {name: value.clone() for name, value in field.state_dict().items()}
    learner = PaperLearner(field, [item], tuning, features, looked_at)
    learner.optimised.optimizer.param_groups[0]["lr"] = 2e-3  # a field of random weights is far from any picture
    (_, before) = learner.pictures()[0]
    course = learn(learner, tuning)
    (wanted, after) = learner.pictures()[0]
    assert course.done == 8 and course.best is None
    assert inside(after, item) < 0.8 * inside(before, item)
    assert (wanted[~item.head_mask] == 0).all()
    assert all(torch.equal(value, untouched[name]) for name, value in field.state_dict().items())
    assert course.codes is not None
    assert np.abs(course.codes[0].expression - subject.codes.expression).max() > 1e-3
    assert not any("background" in name or ".distance." in name for name in course.kept)
    better = replace(subject, codes=course.codes[0], personal=PersonalWeights(field.weights_hash, course.kept))
    slow = Head(field, better, sampler="slabs").field
    for name, value in learner.tuned.state_dict().items():
        torch.testing.assert_close(slow.state_dict()[name], value, atol=2e-4, rtol=2e-3)


def test_known_distances_are_held() -> None:
    field = TwoStreamField(tiny_config(geometry="distance")).eval()
    learner = PaperLearner(field, [capture(make_subject(field.config))], Tuning(steps=1), features, looked_at)
    learner.step(0)
    assert (
        not any(".distance." in name for name in learner.changes()) and "streams.face.trunk.0.weight" in learner.learned
    )


def test_photographs_share_the_network_and_have_codes_of_their_own() -> None:
    field = make_field(tiny_config())
    subject = make_subject(field.config)
    items = [capture(subject), capture(subject, Gaze(-0.1, 0.3))]
    learner = PaperLearner(field, items, Tuning("short", "paper", steps=3), features, looked_at)
    learn(learner, Tuning("short", "paper", steps=1))
    first, second = learner.codes()
    assert np.abs(first.illumination - subject.codes.illumination).max() > 0
    np.testing.assert_array_equal(second.illumination, subject.codes.illumination)
    learner.step(1)
    assert np.abs(learner.codes()[1].illumination - subject.codes.illumination).max() > 0


def test_the_papers_settings_are_kept() -> None:
    field = make_field(tiny_config())
    config = PaperLearner(field, [capture(make_subject(field.config))], Tuning(steps=1), features, looked_at).config
    assert (config.reconstruction, config.perceptual, config.functional, config.disentanglement) == (1, 1, 1, 1)
    assert config.learning_rate == 1e-4 and config.functional_content == 1e-3
    assert config.code_weights == (1e-3, 1.0, 1e-3, 1e-3) and config.learn_codes and not config.learn_cameras


def test_rays_far_from_the_mask_are_left_out_and_eyes_kept() -> None:
    item = capture(make_subject(tiny_config()))
    whole = ray_targets(item, 16, all_rays=True)
    small = replace(item, parts=np.where(np.arange(32) < 16, item.parts, 0).astype(np.uint8))
    part = near_mask(whole, small, 16)
    assert 0 < len(part.rays) < len(whole.rays) and len(part.distance) == len(part.rays)
    np.testing.assert_array_equal(part.rays[part.eye_rays], part.rays)
    assert (part.rays % 16).max() == 7 + 3, "feature pixels beyond the mask"


def test_masked_pictures_are_compared_as_the_whole_ones_are() -> None:
    generator = torch.Generator().manual_seed(0)
    image, other, target = (torch.rand(1, 3, 96, 96, generator=generator) for _ in range(3))
    mask = torch.zeros(1, 1, 96, 96)
    mask[..., 30:50, 40:62] = 1.0
    asked = []

    def counting(pictures: torch.Tensor) -> list[torch.Tensor]:
        asked.append(pictures.shape)
        return features(pictures)

    compare = MaskedComparison()
    for picture in (image, other):
        expected = perceptual_loss(features, picture * mask, target * mask)
        torch.testing.assert_close(compare(counting, picture * mask, target * mask), expected)
    assert len(asked) == 3 and all(shape[-2:] == (64, 64) for shape in asked), "the target once, the box alone"


def test_what_would_not_fit_into_a_subject_is_refused() -> None:
    with torch.device("meta"):
        published, wide = TwoStreamField(PAPER), TwoStreamField(replace(PAPER, hidden=900))
    assert len(learned_names(published)) > 40
    with pytest.raises(UserError, match=r"takes \d+ MiB, a subject file holds 12"):
        learned_names(wide)
