from __future__ import annotations

import argparse
import json
import os
import sys
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from benchmarks.fuzz_targets import published_weights
from gazenerf.checkpoints import (
    BUNDLED,
    FORMAT,
    OFFSETS,
    bundled_fields,
    import_official,
    load_field,
    save_field,
    weights_hash,
)
from gazenerf.cli.main import main
from gazenerf.errors import UserError
from gazenerf.field.config import PRESETS, FieldConfig
from gazenerf.field.model import TwoStreamField

PARITY = Path(__file__).parents[1].parent / "shared" / "parity"


@pytest.fixture(scope="module")
def field() -> TwoStreamField:
    torch.manual_seed(0)
    return TwoStreamField(PRESETS["tiny"])


@pytest.fixture
def official() -> Path:
    path = PARITY / "official_checkpoint.json"
    if not path.is_file():
        pytest.skip(f"no published layout at {path}")
    return path


def test_round_trip(field: TwoStreamField, tmp_path: Path) -> None:
    path = tmp_path / "field.safetensors"
    save_field(field, path, {"steps": 3})
    found = load_field(path)
    assert found.config == field.config and found.about == {"steps": 3} and not found.training
    assert found.weights_hash == weights_hash(path) and len(found.weights_hash) == 16
    for name, value in field.state_dict().items():
        assert torch.equal(found.state_dict()[name], value), name
    assert not any(value.requires_grad for value in found.parameters())


def test_half_precision_is_smaller_and_close(field: TwoStreamField, tmp_path: Path) -> None:
    save_field(field, tmp_path / "full.safetensors")
    save_field(field, tmp_path / "half.safetensors", half=True)
    sizes = [(tmp_path / f"{name}.safetensors").stat().st_size for name in ("full", "half")]
    assert sizes[1] < 0.6 * sizes[0]
    for name, value in load_field(tmp_path / "half.safetensors").state_dict().items():
        assert value.dtype == torch.float32
        assert torch.allclose(value, field.state_dict()[name], atol=1e-3, rtol=1e-3)


def damaged(field: TwoStreamField, path: Path, change: Callable[[dict[str, Any], dict[str, str]], None]) -> Path:
    weights = {name: value.detach().clone().contiguous() for name, value in field.state_dict().items()}
    metadata = {"format": FORMAT, "config": json.dumps(field.config.to_dict()), "about": "{}"}
    change(weights, metadata)
    save_file(weights, path, metadata=metadata)
    return path


def _config(**values: Any) -> Callable[[dict[str, Any], dict[str, str]], None]:
    return lambda _, metadata: metadata.update(config=json.dumps(json.loads(metadata["config"]) | values))


BIAS = "streams.face.density.bias"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda weights, _: weights[BIAS].fill_(float("nan")), "NaN"),
        (lambda weights, _: weights[BIAS].fill_(float("inf")), "infinite"),
        (lambda weights, _: weights.pop(BIAS), "missing"),
        (lambda weights, _: weights.update(extra=torch.zeros(1)), "unknown"),
        (lambda weights, _: weights.update({BIAS: torch.zeros(2)}), "needs"),
        (lambda _, metadata: metadata.update(format="other"), "import-checkpoint"),
        (lambda _, metadata: metadata.pop("config"), "config"),
        (lambda _, metadata: metadata.update(config="{"), "cannot read"),
        (lambda _, metadata: metadata.update(config="[1]"), "not a list"),
        (lambda _, metadata: metadata.update(config="[" * 100000), "nested too deeply"),
        (lambda weights, _: weights.update({BIAS: torch.zeros(1).long()}), "I64"),
        *((_config(metres_per_unit=value), "metres_per_unit is") for value in (0.0, -1.0, float("inf"), float("nan"))),
        *((_config(**{name: float("nan")}), f"{name} is nan") for name in ("z_near", "z_far", "shell", "ray_offset")),
        (_config(input_gains=[1.0, 1.0, float("inf"), 1.0, 1.0]), "input_gains is inf"),
        (_config(eyes_box=[0.0, 0.0, 0.0, 1.0, 1.0, float("inf")]), "eyes_box is inf"),
        (_config(trained_gaze_range=[20.0, 400.0]), "trained_gaze_range is 400"),
        (lambda _, metadata: metadata.update(about="[]"), "provenance"),
        (_config(hidden=64), "needs"),
        (_config(hidden=4096, layers=64, feature_size=16), "parameters"),
        (_config(hidden=10**12), "hidden"),
        (_config(identity=10**12), "identity"),
        (_config(surprise=1), "surprise"),
    ],
)
def test_damage_is_one_line(field: TwoStreamField, tmp_path: Path, change: Any, message: str) -> None:
    path = damaged(field, tmp_path / "bad.safetensors", change)
    with pytest.raises(UserError, match=message) as caught:
        load_field(path)
    assert "\n" not in str(caught.value)


def test_truncated_missing_and_foreign_files(field: TwoStreamField, tmp_path: Path) -> None:
    path = tmp_path / "field.safetensors"
    with pytest.raises(UserError, match="no checkpoint"):
        load_field(path)
    save_field(field, path)
    whole = path.read_bytes()
    for content in (b"", whole[:7], whole[:100], whole[:-1], b"\xff" * 64, os.urandom(1000)):
        path.write_bytes(content)
        with pytest.raises(UserError, match="cannot read"):
            load_field(path)


def test_official_checkpoint_is_the_published_network(official: Path) -> None:
    found = import_official(official)
    assert found.field.config.image_size == 64 and found.field.config.samples == 16
    assert found.field.config.ray_offset == 0.0 and found.field.config.gaze_label_signs == (-1.0, -1.0)
    assert found.options["featmap_nc"] == 48 and found.options["bg_type"] == "white"
    assert set(found.offsets) == set(OFFSETS)
    assert {name: tuple(value.shape)[1:] for name, value in found.offsets.items()} == {
        "iden_offset": (100,),
        "expr_offset": (79,),
        "appea_offset": (127,),
        "delta_EulurAngles": (3,),
        "delta_Tvecs": (3, 1),
    }
    with np.load(PARITY / "gazenerf_a.npz", allow_pickle=False) as data, torch.no_grad():
        inputs = {key[3:]: torch.from_numpy(data[key]) for key in data.files if key.startswith("in.")}
        image = found.field.published_forward(
            inputs["shape_code"],
            inputs["appearance_code"],
            inputs["gaze"],
            inputs["c2w_rotation"],
            inputs["camera_position"],
            inputs["inv_intrinsics"],
        )["image"]
        assert np.abs(image.numpy() - data["out.image"]).max() < 1e-4


@pytest.fixture(scope="module")
def published() -> dict[str, Any]:
    """A small network under published names, with what lies beside it."""
    torch.manual_seed(1)
    field = TwoStreamField(FieldConfig(image_size=32, feature_size=8, feature_channels=24, hidden=16))
    return {"net": published_weights(field), "para": {"num_sample_coarse": 16}, "iden_offset": torch.zeros(3, 100)}


def resave(official: Path, path: Path, change: Callable[[dict[str, Any]], Any]) -> Path:
    """A file in the published layout with something changed, without its class-bound options."""
    from gazenerf.archives import TorchArchive

    with TorchArchive(official) as archive:
        content = {
            "net": {name: archive.tensor(record) for name, record in archive.content["net"].items()},
            "para": dict(archive.content["para"].values),
            "iden_offset": archive.tensor(archive.content["iden_offset"]),
        }
    change(content)
    torch.save(content, path)
    return path


class Executed:
    """Pickles as a call."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return self.call


class Callback:
    """An object that somebody's training saved beside the weights."""

    def __init__(self) -> None:
        self.best, self.scores = Path("best.ckpt"), [1.0, 2.0]


Callback.__module__ = "somebody.callbacks"


@pytest.fixture
def somebody(monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with `Callback`, so that it can be pickled; reading it must not need the package."""
    module = types.ModuleType("somebody.callbacks")
    module.Callback = Callback  # pyright: ignore[reportAttributeAccessIssue]
    monkeypatch.setitem(sys.modules, "somebody.callbacks", module)
    monkeypatch.setitem(sys.modules, "somebody", types.ModuleType("somebody"))


def save_legacy(content: Any, path: Path) -> None:
    torch.save(content, path, _use_new_zipfile_serialization=False)


FORMS: dict[str, Callable[[dict[str, Any], Path], None]] = {
    "bare": lambda c, path: torch.save(c["net"], path),
    "under state_dict": lambda c, path: torch.save({"state_dict": c["net"], "epoch": 3}, path),
    "under model": lambda c, path: torch.save({"model": c["net"]}, path),
    "data parallel": lambda c, path: torch.save({"net": {f"module.{n}": v for n, v in c["net"].items()}}, path),
    "lightning": lambda c, path: torch.save(
        {"state_dict": {f"model.{n}": v for n, v in c["net"].items()}, "callbacks": {"x": Callback()}}, path
    ),
    "before 1.6": save_legacy,
    "before 1.6, bare": lambda c, path: save_legacy(c["net"], path),
    "safetensors": lambda c, path: save_file({n: v.contiguous() for n, v in c["net"].items()}, path),
    "namespace": lambda c, path: torch.save({**c, "args": argparse.Namespace(lr=1e-3, out=Path("x"))}, path),
    "more than the network": lambda c, path: torch.save({"net": {**c["net"], "loss.vgg.mean": torch.zeros(3)}}, path),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.usefixtures("somebody")
def test_weights_are_found_in_every_form(published: dict[str, Any], tmp_path: Path, form: str) -> None:
    torch.save(published, tmp_path / "plain.pth")
    path = tmp_path / "form.bin"
    FORMS[form](published, path)
    sys.modules.pop("somebody.callbacks")  # who reads it does not have it
    found, expected = import_official(path), import_official(tmp_path / "plain.pth")
    for name, value in expected.field.state_dict().items():
        assert torch.equal(found.field.state_dict()[name], value), name
    assert found.ignored == (("loss.vgg.mean",) if form == "more than the network" else ())
    assert (found.offsets == {}) == (form not in ("before 1.6", "namespace"))


HOSTILE: dict[str, Callable[[], Any]] = {
    "a call": lambda: Executed(os.system, "touch victim"),
    "a call of somebody's": lambda: Executed(Callback),
    "getattr": lambda: Executed(getattr, Path("victim"), "touch"),
}


@pytest.mark.parametrize("save", [torch.save, save_legacy])
@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.usefixtures("somebody")
def test_hostile_files_are_refused_in_every_form(
    published: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    what: str,
    save: Callable[[Any, Path], None],
) -> None:
    monkeypatch.chdir(tmp_path)
    for number, content in enumerate(
        ({"model": published["net"], "x": HOSTILE[what]()}, {**published["net"], "x": HOSTILE[what]()})
    ):
        path = tmp_path / f"{number}.pth"
        save(content, path)
        with pytest.raises(UserError, match="no use for"):
            import_official(path)
    assert not (tmp_path / "victim").exists()


@pytest.mark.parametrize("step", [61, 4001])
def test_every_truncation_of_an_old_file_is_refused(published: dict[str, Any], tmp_path: Path, step: int) -> None:
    save_legacy({"net": published["net"]}, tmp_path / "whole.pth")
    whole = (tmp_path / "whole.pth").read_bytes()
    for length in [*range(0, 1500, step), *range(1500, len(whole) - 1, len(whole) // 20)]:
        (tmp_path / "cut.pth").write_bytes(whole[:length])
        with pytest.raises(UserError, match="cannot import"):
            import_official(tmp_path / "cut.pth")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["net"]["neural_render.bg_featmap"].fill_(float("nan")), "NaN"),
        (lambda c: c["iden_offset"].fill_(float("nan")), "NaN"),
        (lambda c: c["net"].pop("neural_render.bg_featmap"), "no published network"),
        (lambda c: c["net"].update({"module.neural_render.bg_featmap": torch.zeros(3)}), "several networks"),
        (lambda c: c["net"].update({"fg_CD_predictor_face.density_module.bias": torch.zeros(1).long()}), "int64"),
        (lambda c: c["net"].pop("fg_CD_predictor_face.density_module.bias"), "missing"),
        (lambda c: c["net"].update({"fg_CD_predictor_face.density_module.bias": torch.zeros(3)}), "needs"),
        (lambda c: c["net"].update({"neural_render.bg_featmap": torch.zeros(5)}), "cannot import"),
        (lambda c: c.update(net=3), "no published network"),
        (lambda c: c["para"].update(num_sample_coarse="many"), "num_sample_coarse"),
        (lambda c: c["para"].update(num_sample_coarse=float("inf")), "num_sample_coarse"),
        (lambda c: c["para"].update(num_sample_coarse=10**9), "samples"),
        (lambda c: c["para"].update(world_z1=-9.0), "z_near"),
        (lambda c: c["para"].update(iden_code_dims=50), "code sizes"),
        (lambda c: c.update(epoch=Executed(os.system, "true")), "no use for"),
    ],
)
def test_bad_official_checkpoints_are_one_line(official: Path, tmp_path: Path, change: Any, message: str) -> None:
    path = resave(official, tmp_path / "bad.pth", change)
    with pytest.raises(UserError, match=message) as caught:
        import_official(path)
    assert "\n" not in str(caught.value)


def test_options_may_be_a_dictionary_or_missing(official: Path, tmp_path: Path) -> None:
    assert import_official(resave(official, tmp_path / "a.pth", lambda c: None)).field.config.samples == 16
    found = import_official(resave(official, tmp_path / "b.pth", lambda c: (c.pop("para"), c.pop("iden_offset"))))
    assert found.field.config.samples == 64 and found.offsets == {}


def test_command_writes_field_and_offsets(official: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "imported.safetensors"
    assert main(["import-checkpoint", str(official), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    found = load_field(out)
    assert found.weights_hash in printed
    assert found.about["imported_from"] == official.name
    offsets = load_file(out.with_suffix(".offsets.safetensors"))
    assert offsets["expr_offset"].shape[1] == 79


def test_command_refuses_in_one_line(official: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "imported.safetensors"
    cut = tmp_path / "cut.pth"
    cut.write_bytes(official.read_bytes()[:200000])
    for words in (
        [str(cut), "--out", str(out)],
        [str(tmp_path / "none.pth"), "--out", str(out)],
        [str(official), "--out", str(tmp_path / "field.pth")],
    ):
        assert main(["import-checkpoint", *words]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut.pth"]


def test_bundled_fields_have_names() -> None:
    assert list(bundled_fields()) == ["portrait", "portrait-sdf", "small"]
    sizes = {name: load_field(name).config.image_size for name in bundled_fields()}
    assert sizes == {"portrait": 512, "portrait-sdf": 512, "small": 256}
    assert (
        load_field("portrait-sdf").config.geometry == "distance" and load_field("portrait").config.geometry == "density"
    )
    assert load_field().weights_hash == weights_hash(BUNDLED) == load_field("portrait-sdf").weights_hash
    with pytest.raises(UserError, match="no checkpoint at large; give --checkpoint portrait-sdf, portrait or small"):
        load_field("large")
