"""An evaluation from a folder of captures to its report."""

from __future__ import annotations

import json
import pickle
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace

import pytest

from gazenerf.checkpoints import save_field
from gazenerf.data import CaptureSet, SynthesizeOptions, synthesize
from gazenerf.errors import UserError
from gazenerf.evaluation.measuring import Measuring
from gazenerf.evaluation.quality import Instruments, measurements
from gazenerf.evaluation.run import EvaluateOptions, evaluate
from gazenerf.training.run import TrainOptions, chosen_config, train_field
from tests.field_doubles import make_field, tiny_config


@pytest.fixture(scope="module")
def captures(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("captures")
    try:
        synthesize(folder, SynthesizeOptions(people=2, views=4, size=64, seed=3))
    except UserError as error:
        pytest.skip(str(error))
    return folder


def test_captures_become_a_field_and_a_report(captures: Path, tmp_path: Path) -> None:
    settings = ("steps=2", "batch=1", "perceptual=0", 'field_overrides={"feature_size": 16}')
    told: list[tuple[str, int, int]] = []
    options = TrainOptions(
        data=captures, out=tmp_path / "run", preset="tiny", held_out=1, held_out_views=0.3, settings=settings,
        device="cpu", precision="float32",
    )  # fmt: skip
    field = train_field(options, lambda *step: told.append(step))
    assert field is not None and field.is_file() and [step[1:] for step in told] == [(1, 2), (2, 2)]
    found = evaluate(
        EvaluateOptions(
            data=captures, out=tmp_path / "quality.json", checkpoint=field, held_out=1, held_out_views=0.3, limit=1,
            iris=False,
        )
    )  # fmt: skip
    report = json.loads(found.file.read_text())
    assert report["unseen_people"] == [1] and report["unseen"]["captures"] == 1 == found.groups["unseen"]["captures"]
    assert report["people"]["1"]["psnr_head"] == found.people["1"]["psnr_head"]


def test_what_fails_is_listed_and_the_next_run_measures_it_alone(captures: Path, tmp_path: Path, monkeypatch) -> None:
    """With doubles of the field and of what measures it, which takes longer."""
    sizes = CaptureSet(captures)[0].codes.sizes
    names = dict(zip(("identity", "expression", "texture", "illumination"), sizes, strict=True))
    save_field(make_field(tiny_config(**names)), tmp_path / "field.safetensors")
    monkeypatch.setattr("gazenerf.evaluation.measuring._instruments", lambda *_: Instruments())
    measured: list[str] = []

    def measure(model, item, *_) -> list[dict[str, float]]:
        measured.append(item.name)
        if item.name == broken:
            raise UserError("its depth is all sea")
        return [{"psnr_head": 20.0 + item.capture.view / 3}]

    monkeypatch.setattr("gazenerf.evaluation.measuring.measure", measure)
    options = EvaluateOptions(
        data=captures, out=tmp_path / "q.json", checkpoint=tmp_path / "field.safetensors", held_out=1, iris=False
    )
    broken = "person 1 view 2"
    found = evaluate(options)
    assert found.failed == {broken: "its depth is all sea"} and found.groups["all"]["captures"] == len(measured) - 1
    assert json.loads(options.out.read_text())["failed"] == found.failed
    everything, broken = list(measured), ""
    measured.clear()
    assert evaluate(options).failed == {} and measured == ["person 1 view 2"]
    again, whole = json.loads(options.out.read_text()), None
    assert sorted(path.name for path in tmp_path.iterdir()) == ["field.safetensors", "q.json"]
    measured.clear()
    evaluate(options)
    whole = json.loads(options.out.read_text())
    assert measured == everything and whole == again, "a whole run gives the same"
    broken = "person 1 view 2"
    evaluate(options)
    lines = (tmp_path / "q.json.rows").read_text().splitlines()
    (tmp_path / "q.json.rows").write_text("\n".join(lines[:-1]) + "\n" + lines[-1][:20])
    measured.clear()
    evaluate(options)
    assert len(measured) == 2, "a line that was cut short is measured again"


def test_jobs_pass_between_processes(captures: Path) -> None:
    job = Measuring(EvaluateOptions(data=captures, out=Path("q.json")), "abc")
    items = measurements(CaptureSet(captures)[:1], [(0.0, 0.0)])
    there, (capture, iris) = pickle.loads(pickle.dumps((job, items)))
    assert there == job and (capture.capture.image == items[0].capture.image).all() and iris.name == items[1].name


def test_published_estimators_are_for_the_paper_protocol_alone(captures: Path, monkeypatch) -> None:
    from gazenerf.evaluation import measuring

    monkeypatch.setattr(measuring, "load_view_reader", lambda path: SimpleNamespace(knows_labels=False))
    options = EvaluateOptions(data=captures, out=Path("q.json"), gaze_estimator=Path("published.pth"), iris=False)
    with ExitStack() as stack, pytest.raises(UserError, match="only --protocol paper"):
        measuring._instruments(options, 64, {}, stack)


def test_captures_of_another_head_model_are_refused(captures: Path, tmp_path: Path) -> None:
    save_field(make_field(tiny_config()), tmp_path / "other.safetensors")
    options = EvaluateOptions(data=captures, out=tmp_path / "q.json", checkpoint=tmp_path / "other.safetensors")
    with pytest.raises(UserError, match="the field takes"):
        evaluate(options)
    assert not (tmp_path / "q.json").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"preset": "huge"}, "small, tiny, paper"),
        ({"settings": ("steps",)}, "KEY=VALUE"),
        ({"settings": ("stepz=3",)}, "unknown training settings: stepz"),
    ],
)
def test_unknown_settings_are_one_line(change: dict, message: str) -> None:
    with pytest.raises(UserError, match=message):
        chosen_config(TrainOptions(**({"data": Path("d"), "out": Path("o")} | change)))
