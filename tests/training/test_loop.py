"""A run learns, can be killed, and goes on with the same curve."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from gazenerf.checkpoints import load_field
from gazenerf.errors import UserError
from gazenerf.field.compositing import StreamSamples, composite_stream
from gazenerf.field.config import PRESETS as FIELDS
from gazenerf.field.model import TwoStreamField
from gazenerf.training.batches import BatchMaker
from gazenerf.training.config import PRESETS, TrainConfig
from gazenerf.training.forward import render_batch
from gazenerf.training.geometry_terms import OneStreamRays, one_stream_terms
from gazenerf.training.loop import train, trained_range
from gazenerf.training.objective import Objective, Offsets, schedule
from gazenerf.training.runtime import Runtime
from tests.training.conftest import EYES

FIELD = replace(FIELDS["tiny"], identity=4, expression=3, texture=5)
CONFIG = replace(PRESETS["tiny"], steps=8, learning_rate=3e-3)


def curve(folder) -> list[float]:
    rows = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    return [row["whole"] for row in rows if "whole" in row]


def run(captures, folder, eyeballs, config=CONFIG, **options):
    return train(
        captures, FIELD, config, folder, eyeballs=eyeballs, runtime=Runtime("cpu", precision="float32"), **options
    )


def test_a_killed_run_resumes_with_the_same_curve(toy_captures, toy_eyeballs, tmp_path):
    run(toy_captures, tmp_path / "whole", toy_eyeballs, held_out=toy_captures[:1])

    class Killed(Exception):
        pass

    def kill(progress):
        if progress.step == 6:
            raise Killed

    with pytest.raises(Killed):
        run(toy_captures, tmp_path / "parts", toy_eyeballs, save_every=4, on_step=kill)
    run(toy_captures, tmp_path / "parts", toy_eyeballs, resume=True)
    a, b = curve(tmp_path / "whole"), curve(tmp_path / "parts")
    assert len(a) == len(b) == CONFIG.steps
    assert np.allclose(a, b, atol=1e-6)
    field = load_field(tmp_path / "whole" / "field.safetensors")
    assert field.config.trained_gaze_range == trained_range(toy_captures)
    assert field.about["steps"] == CONFIG.steps
    assert (tmp_path / "whole" / "previews" / f"{CONFIG.steps:06d}.png").is_file()


def test_training_lowers_every_loss_it_is_given(toy_captures, toy_eyeballs, tmp_path):
    config = replace(CONFIG, steps=80, batch=2)
    seen = []
    run(toy_captures, tmp_path, toy_eyeballs, config, on_step=lambda progress: seen.append(progress.parts))
    for name in ("whole", "background", "surface", "eyeball"):
        first = np.mean([parts[name] for parts in seen[:8]])
        last = np.mean([parts[name] for parts in seen[-8:]])
        assert last < 0.9 * first, (name, first, last)


@pytest.mark.parametrize("merge", ["joint", "max"])
def test_gradients_reach_both_streams_and_the_renderer(toy_captures, toy_eyeballs, merge):
    model = TwoStreamField(replace(FIELD, merge=merge))
    batch = BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs).batch([0, 9], np.random.default_rng(0))
    loss, parts = Objective(model, CONFIG, len(toy_captures))(batch, 0)
    assert torch.isfinite(loss) and "face" in parts and "eyes" in parts
    loss.backward()
    for name, value in model.named_parameters():
        if not name.startswith("renderer.background"):
            assert value.grad is not None and float(value.grad.abs().max()) > 0, name


def test_the_slabs_of_the_paper_train_too(toy_captures):
    config = replace(FIELD, merge="max", samples=12)
    batch = BatchMaker(toy_captures, 16, all_rays=True).batch([0], np.random.default_rng(0))
    render = render_batch(TwoStreamField(config), batch, shell=None, samples=0, geometry=False, face_image=True)
    assert render.image.shape == (1, 3, 32, 32) and render.face_image is not None and not render.terms


@pytest.mark.parametrize("motion", ["none", "feature_rotation"])
def test_one_stream_learns_from_pictures_and_from_geometry(toy_captures, motion):
    model = TwoStreamField(replace(FIELD, streams="one", eye_motion=motion))
    batch = BatchMaker(toy_captures, 16).batch([0, 1], np.random.default_rng(0))
    loss, parts = Objective(model, CONFIG, 16)(batch, 0)
    assert set(parts) == {"whole", "background", "eyes_merged", "depth", "surface", "opacity", "empty"}
    assert all(part.item() > 0 for part in parts.values())
    loss.backward()
    for name, value in model.named_parameters():
        if not name.startswith("renderer.background"):
            assert value.grad is not None and float(value.grad.abs().max()) > 0, name


def test_one_stream_that_lies_where_it_should_has_no_geometry_to_learn(toy_captures):
    """The terms vanish for light that stops at the captured surface, and for that alone."""
    batch = BatchMaker(toy_captures, 16).batch([0, 1], np.random.default_rng(0))
    model = TwoStreamField(replace(FIELD, streams="one", eye_motion="none"))
    codes = batch.shape_code, batch.appearance_code, model.label(batch.gaze)
    t = batch.distance[..., None] + torch.linspace(-0.2, 0.2, 41)
    found = {}
    for name, edge in (("right", 0.0), ("deeper", 0.1)):
        density = torch.where(t >= batch.distance[..., None] + edge, 400.0, 0.0)
        covered = (batch.face_coverage + batch.eyes_coverage)[..., None]
        seen = composite_stream(StreamSamples(density, torch.zeros(*t.shape, 1)), torch.full_like(t, 0.01))
        seen = replace(seen, opacity=torch.where(batch.has_surface, covered[..., 0], 0.0))
        rays = OneStreamRays(t, density, seen, model.condition("head", *codes))
        found[name] = one_stream_terms(model, batch, rays)
    assert float(found["right"]["opacity"]) == pytest.approx(0.0, abs=1e-6)
    assert float(found["right"]["surface"]) == 0.0 and float(found["deeper"]["surface"]) > 0.1
    assert float(found["right"]["depth"]) < 0.5 * float(found["deeper"]["depth"])


def test_squared_errors_are_what_a_run_can_learn_by(toy_captures, toy_eyeballs):
    model = TwoStreamField(FIELD)
    batch = BatchMaker(toy_captures, 16, eyeballs=toy_eyeballs).batch([0, 9], np.random.default_rng(0))
    config = replace(CONFIG, shell_noise=0.0)
    found = {}
    for error in ("l1", "l2"):
        torch.manual_seed(0)
        found[error] = Objective(model, replace(config, pixel_error=error), len(toy_captures))(batch, 0)[1]
    for name in ("whole", "background", "eyes_merged", "face", "eyes"):
        assert 0.0 < float(found["l2"][name]) < float(found["l1"][name]), name
    assert float(found["l2"]["depth"]) == pytest.approx(float(found["l1"]["depth"]))
    with pytest.raises(ValueError, match="pixel_error must be one of l1, l2"):
        TrainConfig.from_dict({"pixel_error": "l3"})


def test_rigid_eyes_train_and_need_their_centres(toy_captures, toy_eyeballs, tmp_path):
    field = replace(FIELD, eye_motion="rigid")
    options = {"eyeballs": toy_eyeballs, "runtime": Runtime("cpu", precision="float32")}
    with pytest.raises(UserError, match="centres"):
        train(toy_captures, field, CONFIG, tmp_path, **options)
    centres = EYES, np.zeros((field.identity, 2, 3))
    trained = train(toy_captures, field, CONFIG, tmp_path, eye_centres=centres, **options)
    assert trained.eye_centres is not None
    assert np.allclose(load_field(tmp_path / "field.safetensors").eye_centres.mean.numpy(), EYES)
    assert trained.stream("face").inputs == trained.stream("eyes").inputs + 2


def test_offsets_start_as_nothing_and_cameras_turn_rays(toy_captures):
    offsets = Offsets(4, (4, 3, 5, 27))
    batch = BatchMaker(toy_captures, 16).batch([2], np.random.default_rng(0))
    still = offsets.move_rays(batch)
    assert torch.allclose(still.rays_d, batch.rays_d, atol=1e-6)
    with torch.no_grad():
        offsets.angles[2] = torch.tensor([0.0, 0.1, 0.0])
        offsets.shift[2] = torch.tensor([0.0, 0.0, 0.5])
    moved = offsets.move_rays(batch)
    assert torch.allclose(moved.rays_o - batch.rays_o, torch.tensor([0.0, 0.0, 0.5]).expand_as(batch.rays_o), atol=1e-5)
    angle = torch.arccos((moved.rays_d * batch.rays_d).sum(-1).clamp(-1, 1))
    assert float(angle.max()) == pytest.approx(0.1, abs=0.01)


def test_learned_codes_are_pulled_back(toy_captures, toy_eyeballs, tmp_path):
    config = replace(CONFIG, steps=3, learn_codes=True, learn_cameras=True, disentanglement=1.0)
    seen = []
    run(toy_captures, tmp_path, toy_eyeballs, config, on_step=lambda progress: seen.append(progress.parts))
    assert seen[0]["disentanglement"] == 0.0 and seen[-1]["disentanglement"] >= 0.0


def test_the_schedule_warms_up_and_ends_low():
    config = TrainConfig(steps=100, warmup=10, learning_rate=1.0, final_learning_rate=0.1)
    rates = [schedule(config, step) for step in range(100)]
    assert rates[0] == pytest.approx(0.1) and max(rates) == pytest.approx(1.0)
    assert rates[-1] == pytest.approx(0.1, abs=0.01) and rates[10:] == sorted(rates[10:], reverse=True)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"captures": []}, "no captures"), ({"resume": True}, "nothing to resume"), ({"field": 1}, "codes")],
)
def test_bad_input_is_one_line(toy_captures, toy_eyeballs, tmp_path, change, message):
    field = FIELD if "field" not in change else FIELDS["tiny"]
    captures = change.get("captures", toy_captures)
    with pytest.raises(UserError, match=message) as caught:
        train(captures, field, CONFIG, tmp_path, eyeballs=toy_eyeballs, resume=change.get("resume", False))
    assert "\n" not in str(caught.value) and not (tmp_path / "field.safetensors").exists()


def test_unknown_settings_are_refused():
    with pytest.raises(ValueError, match="unknown training settings: speed"):
        TrainConfig.from_dict({"speed": 3})


@pytest.mark.parametrize("level", [True, False])
def test_the_background_that_is_saved_is_level_where_that_is_wanted(toy_captures, toy_eyeballs, tmp_path, level):
    initial = TwoStreamField(FIELD)
    with torch.no_grad():
        initial.renderer.background_features[..., 8:, 4:12] += 3.0  # a ghost where heads are
    run(toy_captures, tmp_path, toy_eyeballs, replace(CONFIG, steps=1, level_background=level), initial=initial)
    found = load_field(tmp_path / "field.safetensors").renderer.background_features
    assert bool((found.std(dim=(2, 3)) < 1e-6).all()) == level
    assert float((found[..., 0, :].mean() - initial.renderer.background_features[..., 0, :].mean()).abs()) < 0.05
