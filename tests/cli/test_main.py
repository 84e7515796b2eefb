"""The command line's frame: what it lists, how it fails, what it loads."""

import os
import subprocess
import sys
import warnings
from types import SimpleNamespace

import pytest
import torch

from gazenerf import __version__
from gazenerf.cli import main as frame
from gazenerf.cli.main import COMMANDS, build_parser, load_command, main
from gazenerf.cli.parser import parsed
from gazenerf.errors import UserError

HEAVY = ("torch", "numpy", "scipy", "pyvista", "vtk", "open3d", "mitsuba", "pyrender", "trimesh", "rich", "shtab")


def command(monkeypatch, run, configure=lambda parser: None) -> None:
    """Put a command of our own in the place of `subjects`."""
    monkeypatch.setattr(frame, "load_command", lambda name: SimpleNamespace(run=run, configure=configure))


def fail(error):
    def run(args):
        raise error

    return run


@pytest.mark.parametrize("words", [["--help"], ["--version"]])
def test_help_and_version_load_nothing_heavy(words):
    script = (
        "import sys, time; started = time.process_time()\n"
        "from gazenerf.cli.main import main\n"
        f"try: main({words!r})\n"
        "except SystemExit as stop: assert stop.code == 0, stop.code\n"
        "print(time.process_time() - started)\n"
        f"print([name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, timeout=30)
    *_, seconds, loaded = done.stdout.splitlines()
    assert loaded == "[]"
    assert float(seconds) < 0.5


def test_help_lists_every_command(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    shown = capsys.readouterr().out
    assert stop.value.code == 0
    assert all(name in shown for name in COMMANDS)


def test_version(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--version"])
    assert stop.value.code == 0 and capsys.readouterr().out == f"gazenerf {__version__}\n"


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_that_the_frame_repeats(name, capsys):
    assert COMMANDS[name] == load_command(name).HELP
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0 and f"usage: gazenerf {name}" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["orbit", "mesh", "check"])
def test_commands_that_render_share_their_source(name):
    words = [name, "--out", "x", "--subject", "ada", "--checkpoint", "w.safetensors", "--gaze", "-10", "20"]
    kind = load_command(name).Options
    options = parsed(kind, build_parser([name]).parse_args(words))
    assert options.subject == "ada" and options.checkpoint.name == "w.safetensors"
    assert options.gaze in ((-10.0, 20.0), ((-10.0, 20.0),))
    fallback = parsed(kind, build_parser([name]).parse_args([name, "--out", "x"]))
    assert fallback.subject is None and fallback.checkpoint is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "COMMAND"),
        (["wander"], "invalid choice: 'wander'"),
        (["orbitt"], "(did you mean orbit?) (see `gazenerf --help`)"),
        (["mesh", "--out", "x", "--surface", "poison"], "(did you mean poisson?) (see `gazenerf mesh --help`)"),
        (["orbit", "--sbject=noa", "--out", "x.mp4"], "--sbject=noa (did you mean --subject?) (see `gazenerf orbit"),
        (["orbit"], "--out"),
        (["orbit", "--out", "x.mp4", "--gaze", "ten", "0"], "--gaze"),
        (["orbit", "--out", "x.mp4", "--smell"], "--smell"),
        (["orbit", "--out", f"{'x' * 300}.mp4"], "304 bytes"),
        (["mesh", "--out", "a\0b"], "NUL"),
        (["completion", "cmd"], "invalid choice: 'cmd'"),
    ],
)
def test_mistyped_words_are_one_line_and_exit_2(words, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(words)
    captured = capsys.readouterr()
    assert stop.value.code == 2 and captured.out == ""
    assert captured.err.startswith("gazenerf: error: ") and captured.err.count("\n") == 1
    assert message in captured.err and "--help`" in captured.err


def test_an_unknown_subject_is_one_line_and_exit_2(tmp_path, capsys):
    out = tmp_path / "o.mp4"
    assert main(["orbit", "--subject", "nao", "--checkpoint", str(tmp_path / "none"), "--out", str(out)]) == 2
    line = capsys.readouterr().err
    assert line.startswith("gazenerf: error: ") and line.count("\n") == 1
    assert not out.exists()


def test_exit_codes_come_from_the_command(monkeypatch):
    for code in (0, 1):
        command(monkeypatch, lambda args, code=code: code)
        assert main(["subjects"]) == code


def test_a_user_error_is_one_line_whatever_its_text(monkeypatch, capsys):
    command(monkeypatch, fail(UserError("two\n  lines; fix it")))
    assert main(["subjects"]) == 2
    assert capsys.readouterr().err == "gazenerf: error: two lines; fix it\n"


def test_a_missing_system_library_names_its_package(monkeypatch, capsys):
    text = "libusb-1.0.so.0: cannot open shared object file: No such file or directory"
    command(monkeypatch, fail(OSError(text)))
    assert main(["subjects"]) == 2
    assert "apt-get install libusb-1.0-0" in capsys.readouterr().err


def test_a_bug_keeps_its_traceback(monkeypatch):
    command(monkeypatch, fail(OSError("disk on fire")))
    with pytest.raises(OSError, match="disk on fire"):
        main(["subjects"])


def test_an_interrupt_is_quiet(monkeypatch, capsys):
    command(monkeypatch, fail(KeyboardInterrupt()))
    assert main(["subjects"]) == 130
    assert capsys.readouterr().err == "gazenerf: interrupted\n"


def test_a_warning_is_one_line(monkeypatch, capsys):
    def run(args):
        warnings.warn("gaze\nbeyond training", stacklevel=1)
        return 0

    command(monkeypatch, run)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        main(["subjects"])
    assert capsys.readouterr().err == "gazenerf: warning: gaze beyond training\n"


def test_a_reader_that_goes_away_is_no_error():
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run(
        [sys.executable, "-m", "gazenerf.cli.main", "completion", "bash"],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    os.close(write)
    assert done.returncode == 141 and done.stderr == ""


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device")
@pytest.mark.parametrize(
    "command", ["orbit --out x.mp4", "sheet --out x.png", "view --port 0", "mesh --out x", "check --out x"]
)
def test_a_gpu_that_is_not_there_is_one_line(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main([*command.split(), "--device", "cuda"]) == 2
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1 and "no CUDA device" in error and "--device cpu" in error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", ["orbit", "sheet", "view", "mesh", "export", "check", "demo", "evaluate", "train"])
def test_every_command_that_computes_takes_a_device(command):
    from gazenerf.options import flag_of, options_of

    taken = {flag_of(name, option) for name, option in options_of(load_command(command).Options).items()}
    assert {"--device", "--precision"} <= taken
