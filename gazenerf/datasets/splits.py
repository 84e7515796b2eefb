"""Which subjects a data set's published split names."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gazenerf.errors import UserError
from gazenerf.files import check_name, read_json
from gazenerf.names import did_you_mean

SPLIT_FILE = "train_test_split.json"
MAX_SPLIT_BYTES = 2**20
MAX_SUBJECTS = 10**4


def published_split(root: Path, split: str, suffix: str = ".h5", file: str = SPLIT_FILE) -> list[str]:
    """Names of the subjects of a split, without suffix, in the order of the published file.

    Without that file they are the files in the folder of the split's name, by name.

    Args:
        root: Of the data set.
        split: Such as `train`.
        suffix: Of subject files; empty where subjects are no files.
        file: That names the splits.

    Raises:
        UserError: neither the file nor the folder is there, or the file has no such split or holds no names.
    """
    path = root / file
    if not path.is_file():
        found = (
            []
            if not suffix
            else sorted(file.name.removesuffix(suffix) for file in (root / split).glob(f"*{suffix}") if file.is_file())
        )
        if not found:
            raise UserError(
                f"{root} has neither {file} nor a folder {split} with {suffix or 'subject'} files; give the folder of "
                "the data set with --root (docs/datasets.md shows the layouts)"
            )
        return found
    value = read_json(path, MAX_SPLIT_BYTES, absent="download it", large="it only names subjects")
    if not isinstance(value, dict) or split not in value:
        known = sorted(value) if isinstance(value, dict) else []
        meant = did_you_mean(split, known)
        raise UserError(f"{path} has no split {split!r}{meant}; it has {', '.join(known) or 'none'}")
    return [_name(item, path, suffix) for item in _listed(value[split], path, split)]


def _listed(value: Any, path: Path, split: str) -> list[Any]:
    if not isinstance(value, list) or not 0 < len(value) <= MAX_SUBJECTS:
        raise UserError(f"the split {split!r} of {path} lists no subjects; choose another --split")
    return value


def _name(value: Any, path: Path, suffix: str) -> str:
    if not isinstance(value, str) or not value.removesuffix(suffix) or Path(value).name != value or "\0" in value:
        raise UserError(f"{path} names the subject {str(value)[:60]!r}, which is no file name")
    check_name(value)
    return value.removesuffix(suffix)
