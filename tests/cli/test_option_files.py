"""Options are saved to a file and replayed from it; what is typed wins."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from gazenerf.cli import main as frame
from gazenerf.cli.main import load_command, main
from gazenerf.cli.option_files import read_options, save_options
from gazenerf.cli.parser import made
from gazenerf.errors import UserError
from gazenerf.options import option, to_dict


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """The options that commands were run with; they do nothing else."""
    seen: list[Any] = []

    def load(name: str) -> Any:
        real = load_command(name)

        class Command:
            Options = real.Options

            @staticmethod
            def run(options: Any) -> int:
                seen.append(options)
                return 0

        return Command

    monkeypatch.setattr(frame, "load_command", load)
    return seen


LINES = {
    "orbit": "--out a.mp4 --subject noa --frames 7 --gaze 1.25 -2 --gaze 3 4 --panels image depth --no-labels --fov 14",
    "sheet": "--out a.png --pitches -10 0 10.123456789 --kind contact --background white",
    "mesh": "--out m --for web --no-page --threshold p50 --close-holes inf --parts face eyes --smooth 0",
    "export": "--out e --layouts colmap --depth --background transparent",
    "check": "--frames pictures --out r --fail-on tsed=0.9",
    "demo": "--out d --quick",
    "fit": "a.jpg b.jpg --out me.safetensors --face 2",
    "redirect": "a.jpg --out b.png --gaze -5 10 --no-mark",
    "synthesize": "--out c --people 3 --views 4",
    "train": "--data c --out r --set a=1 --set b=[1,2] --from x.safetensors",
    "evaluate": "--data c --out r.json --no-iris",
    "import-checkpoint": "a.pth --out f.safetensors",
    "view": "--port 0",
    "subjects": "",
    "completion": "bash",
}  # fmt: skip


@pytest.mark.parametrize("name", LINES)
def test_what_was_given_is_saved_and_given_again(name, ran, tmp_path) -> None:
    file = tmp_path / "o.json"
    assert main([name, *LINES[name].split(), "--save-options", str(file)]) == 0
    saved = json.loads(file.read_text())
    assert saved["command"] == name and "save_options" not in saved["options"]
    assert main([name, "--options", str(file)]) == 0
    assert ran[0] == ran[1]


def test_what_is_typed_wins(ran, tmp_path) -> None:
    file = tmp_path / "o.json"
    main(["orbit", *LINES["orbit"].split(), "--save-options", str(file)])
    assert main(["orbit", "--frames", "9", "--gaze", "0", "5", f"--options={file}", "--panels", "eyes"]) == 0
    assert ran[1].frames == 9 and ran[1].gaze == ((0.0, 5.0),) and ran[1].panels == ("eyes",)
    assert ran[1].subject == "noa" and ran[1].labels is False and ran[1].fov == 14.0
    main(["check", *LINES["check"].split(), "--overwrite", "--save-options", str(tmp_path / "c.json")])
    assert main(["check", "--compare", "a", "b", "--options", str(tmp_path / "c.json")]) == 0
    assert ran[-1].frames is None and ran[-1].compare == (Path("a"), Path("b")), "only one of them can be"
    assert not ran[-1].overwrite, "leave to replace files is not saved"


def test_a_preset_with_what_is_beside_it(ran, tmp_path) -> None:
    (tmp_path / "m.toml").write_text('for = "web"\nout = "m"\nmax-faces = 500\nsmooth = 3\n')
    assert main(["mesh", "--options", str(tmp_path / "m.toml")]) == 0
    assert ran[0].use == "web" and ran[0].rig and ran[0].max_faces == 500 and ran[0].smoothing == 3
    assert main(["mesh", "--options", str(tmp_path / "m.toml"), "--for", "print", "--max-faces", "9"]) == 0
    assert ran[1].formats == ("stl", "ply") and ran[1].max_faces == 9


@pytest.mark.parametrize("name", ["orbit", "mesh", "export", "check"])
def test_sidecars_replay(name, tmp_path) -> None:
    kind = load_command(name).Options
    options = made(kind, {"out": Path("x")} | ({"use": "blender"} if name == "mesh" else {}))
    sidecar = {"format": "some", "frames": [], "options": to_dict(options)}
    content = {"about": sidecar} if name == "check" else sidecar
    (tmp_path / "s.json").write_text(json.dumps(content))
    assert made(kind, read_options(tmp_path / "s.json", kind, name)) == options


def test_a_real_sidecar_replays(tmp_path, monkeypatch, ran) -> None:
    from gazenerf.heads.analytic import AnalyticHead
    from gazenerf.viz.pictures.make_orbit import OrbitOptions, make_orbit, plan_orbit

    options = OrbitOptions(frames=2, size=8, gaze=((1.0, 2.0), (3.0, 4.0)), background="white")
    made_ = make_orbit(AnalyticHead(), plan_orbit(tmp_path / "a", options))
    assert main(["orbit", "--options", str(made_.sidecar), "--out", "b.webp"]) == 0
    assert to_dict(ran[0], OrbitOptions) == to_dict(options)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", '{"fraims": 3}', "no option 'fraims' (did you mean frames?)"),
        ("a.json", '{"no_labels": true}', "did you mean labels?"),
        ("a.json", '{"frames": "many"}', "invalid int value: 'many'"),
        ("a.json", '{"frames": [1, 2]}', "unrecognized arguments: 2"),
        ("a.json", '{"frames": {"a": 1}}', "takes numbers or text"),
        ("a.json", '{"labels": "yes"}', "true or false"),
        ("a.json", '{"frames": 1, "frames ": 2}', "no option 'frames '"),
        ("a.json", '{"gaze_path": "hold", "gaze-path": "hold"}', "given twice"),
        ("a.json", '{"command": "mesh", "options": {}}', "options of `gazenerf mesh`, not of `gazenerf orbit`"),
        ("a.json", '{"options": 3}', "no table"),
        ("a.json", "[1]", "holds no names and values"),
        ("a.json", "{", "cannot be read as JSON"),
        ("a.json", "[" * 100_000, "nested too deeply"),
        ("a.json", '{"out": "a\\u0000.mp4"}', "NUL"),
        ("a.toml", "frames = ", "cannot be read as TOML"),
        ("a.toml", "a = " + "[" * 100_000, "cannot be read as TOML"),
        ("a.json", '{"frames": 3}', "neither"),
        ("none.json", None, "does not exist"),
    ],
)
def test_mistakes_are_one_line(name, text, said, tmp_path, capsys) -> None:
    if text is not None:
        (tmp_path / name).write_text(text)
    assert main(["orbit", "--options", str(tmp_path / name)]) == 2
    captured = capsys.readouterr()
    assert captured.err.count("\n") == 1 and said in captured.err and captured.out == ""


def test_two_of_which_one_can_be_are_refused(tmp_path, capsys) -> None:
    (tmp_path / "a.json").write_text('{"frames": "a", "compare": ["b", "c"]}')
    assert main(["check", "--options", str(tmp_path / "a.json")]) == 2
    assert "--compare is not allowed with --frames" in capsys.readouterr().err


def test_options_that_fail_are_not_saved_and_others_are_not_replaced(ran, tmp_path, capsys) -> None:
    file = tmp_path / "o.json"
    file.write_text("mine")
    assert main(["orbit", "--out", "a.mp4", "--save-options", str(file)]) == 2 and not ran
    assert "add --overwrite" in capsys.readouterr().err and file.read_text() == "mine"
    assert main(["orbit", "--out", "a.mp4", "--save-options", str(file), "--overwrite"]) == 0
    assert json.loads(file.read_text())["options"] == {"out": "a.mp4"}
    assert main(["orbit", "--out", "a.mp4", "--save-options", str(tmp_path / "o.yaml")]) == 2
    assert ".json" in capsys.readouterr().err


def test_bad_options_are_not_saved(tmp_path) -> None:
    assert main(["orbit", "--out", "a.mp4", "--frames", "0", "--save-options", str(tmp_path / "o.json")]) == 2
    assert not list(tmp_path.iterdir())


@dataclass(frozen=True, kw_only=True)
class Odd:
    """Values that are hard to type."""

    name: str = option("", "a word")
    words: tuple[str, ...] = option((), "words", flag="words")
    size: float = option(1.0, "a number")


def test_values_that_look_like_flags_come_back(tmp_path) -> None:
    given = {"name": "--size", "size": -1.5e-300}
    save_options(tmp_path / "o.json", "odd", given)
    assert made(Odd, read_options(tmp_path / "o.json", Odd, "odd")) == Odd(**given)
    save_options(tmp_path / "p.json", "odd", {"words": ("-x",)})
    with pytest.raises(UserError):
        read_options(tmp_path / "p.json", Odd, "odd")
