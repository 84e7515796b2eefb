"""Folders of this machine, and those that a URL names, such as `s3://bucket/captures`, through fsspec."""

from __future__ import annotations

import json
import os
import re
import sys
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeAlias

from gazenerf.errors import UserError
from gazenerf.progress import Progress, silent

Folder: TypeAlias = Path
"""A `pathlib.Path`; for a URL a `UPath` of universal_pathlib, whose methods are the same, but which is no file here."""

CACHE_VARIABLE = "GAZENERF_CACHE"

AT_ONCE = 32
"""Files that are fetched together."""

_URL = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_LOST_SLASH = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/[^/]")
_HERE = ("file", "local")
_INSTALL = "pip install 'gazenerf[urls]'"


def is_url(text: str) -> bool:
    """Whether a text is a URL and no path."""
    return _URL.match(text) is not None


def is_remote(value: object) -> bool:
    """Whether a value is a folder or file that a URL names."""
    library = sys.modules.get("upath")
    return library is not None and isinstance(value, library.UPath)


def folder_of(place: str | Path | Folder) -> Folder:
    """The folder that a text means; nothing is connected to.

    Args:
        place: A path, or a URL of a file system that fsspec knows; `file://` is a path of this machine.

    Raises:
        UserError: an unknown kind of URL, one that needs a package which is not installed, or a `Path` of a URL.
    """
    if not isinstance(place, str):
        if isinstance(place, Path) and _LOST_SLASH.match(str(place)) and not place.exists():
            raise UserError(f"{place} lost a slash as a pathlib.Path; give the URL as text")
        return place
    url = _URL.match(place)
    if url is None:
        return Path(place)
    protocol = url[1]
    if protocol in _HERE:
        return Path(place[url.end() :]).absolute()
    try:
        import fsspec
        from upath import UPath
    except ImportError as error:
        raise UserError(f"folders by URL need: {_INSTALL}") from error
    try:
        fsspec.get_filesystem_class(protocol)
        return UPath(place)  # pyright: ignore[reportReturnType]
    except ImportError as error:
        raise UserError(f"{protocol}:// needs another package ({_words(error)})") from error
    except ValueError as error:
        raise UserError(
            f"{protocol}:// is no kind of URL that fsspec knows; give a path, or s3:// and the like"
        ) from error


def reach(folder: Folder) -> None:
    """See whether a URL's folder can be listed, or does not exist yet; forget what was known of it.

    Raises:
        UserError: it cannot be reached.
    """
    if isinstance(folder, Path):
        return
    try:
        folder.fs.invalidate_cache()
        folder.fs.ls(folder.path)
    except FileNotFoundError:
        return
    except Exception as error:  # each file system has errors of its own
        raise UserError(f"cannot reach {folder} ({_words(error)}); check address, network and credentials") from error


def names_in(folder: Folder) -> set[str]:
    """Names of the files in a folder, nothing where there is none.

    Raises:
        UserError: it cannot be reached.
    """
    reach(folder)
    try:
        if isinstance(folder, Path):
            return {found.name for found in folder.iterdir() if found.is_file()}
        return {Path(about["name"]).name for about in folder.fs.ls(folder.path, detail=True) if about["type"] == "file"}
    except (FileNotFoundError, NotADirectoryError):
        return set()


@contextmanager
def sent_file(target: Folder) -> Iterator[Path]:
    """A temporary file of this machine (same name) that is sent to a URL when the block succeeds.

    It is sent under another name and then renamed, so that it is there whole or not at all.

    Raises:
        UserError: it cannot be written there.
    """
    with tempfile.TemporaryDirectory(prefix="gazenerf-") as here:
        temporary = Path(here) / target.name
        yield temporary
        system: Any = target.fs  # pyright: ignore[reportAttributeAccessIssue]
        coming = target.with_name(f".{uuid.uuid4().hex[:12]}-{target.name}")
        try:
            system.makedirs(target.parent.path, exist_ok=True)  # pyright: ignore[reportAttributeAccessIssue]
            try:
                system.put_file(str(temporary), coming.path)  # pyright: ignore[reportAttributeAccessIssue]
                system.mv(coming.path, target.path)  # pyright: ignore[reportAttributeAccessIssue]
            except BaseException:
                with suppress(Exception):
                    system.rm_file(coming.path)  # pyright: ignore[reportAttributeAccessIssue]
                raise
            system.invalidate_cache()
        except Exception as error:  # each file system has errors of its own
            raise UserError(f"cannot write {target} ({_words(error)}); check what you may do there") from error


def local_copy(folder: str | Path | Folder, progress: Progress = silent) -> Path:
    """A folder of this machine with what a URL's folder holds; of a path, the path.

    Copies are kept, one for each URL, in `GAZENERF_CACHE` (`~/.cache/gazenerf` by default), and of those only what is
    new or changed there is fetched again. Processes that want the same one wait for each other.

    Args:
        folder: A path, a URL, or what `folder_of` makes of it.
        progress: Told about files.

    Raises:
        UserError: see `folder_of`; it cannot be reached or holds nothing, or the copy cannot be written.
    """
    found = folder_of(folder)
    if isinstance(found, Path):
        return found
    from filelock import FileLock
    from fsspec.utils import tokenize

    place = _cache() / f"{found.name or 'folder'}-{tokenize(found.protocol, found.storage_options, found.path)[:16]}"
    try:
        place.mkdir(parents=True, exist_ok=True)
        with FileLock(place / "lock"):
            _fetch(found, place, progress)
    except UserError:
        raise
    except Exception as error:  # each file system has errors of its own
        raise UserError(f"cannot copy {found} to {place} ({_words(error)})") from error
    return place / "files"


def _cache() -> Path:
    given = os.environ.get(CACHE_VARIABLE)
    return Path(given) if given else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "gazenerf"


def _fetch(folder: Any, place: Path, progress: Progress) -> None:
    """Bring `place/files` up to date; `place/versions.jsonl` grows by a line for each file that came."""
    from fsspec.utils import tokenize

    files, versions = place / "files", place / "versions.jsonl"
    reach(folder)
    wanted = _listed(folder)
    if not wanted:
        raise UserError(f"there is nothing at {folder}")
    had, new = _read_versions(versions), {name: tokenize(about) for name, (_, about) in wanted.items()}
    for name in had.keys() - new.keys():
        (files / name).unlink(missing_ok=True)
    missing = [name for name in sorted(new) if had.get(name) != new[name] or not (files / name).is_file()]
    for start in range(0, len(missing), AT_ONCE):
        batch = missing[start : start + AT_ONCE]
        with tempfile.TemporaryDirectory(dir=place) as coming:
            arriving = [str(Path(coming) / str(i)) for i in range(len(batch))]
            folder.fs.get([wanted[name][0] for name in batch], arriving)
            for name, arrived in zip(batch, arriving, strict=True):
                (files / name).parent.mkdir(parents=True, exist_ok=True)
                Path(arrived).replace(files / name)
        with versions.open("a", encoding="utf-8") as log:
            log.writelines(json.dumps([name, new[name]]) + "\n" for name in batch)
        progress("fetching files", start + len(batch), len(missing))


def _listed(folder: Any) -> dict[str, tuple[str, Any]]:
    """Name below a folder to the name at its file system, and what that tells of the file, of all files below it.

    Raises:
        UserError: a name leads out of the folder.
    """
    root, found = folder.path.rstrip("/") + "/", {}
    for name, about in folder.fs.find(folder.path, detail=True).items():
        if not name.startswith(root):
            continue  # of a file, not of a folder
        below = Path(name.removeprefix(root))
        if below.is_absolute() or ".." in below.parts:
            raise UserError(f"{folder} has a file named {name}, which leads out of it")
        if not below.name.startswith("."):  # what is not yet whole
            found[str(below)] = name, about
    return found


def _read_versions(path: Path) -> dict[str, str]:
    found: dict[str, str] = {}
    with suppress(FileNotFoundError):
        for line in path.read_text(encoding="utf-8").splitlines():
            with suppress(ValueError):  # a line that was cut short
                name, version = json.loads(line)
                found[name] = version
    return found


def _words(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
