"""Where the file of a shared field is: in a folder, beside its model card, or in a repository of Hugging Face's Hub."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

from gazenerf.errors import UserError

WEIGHTS = "field.safetensors"
"""Name of the field in a folder of `gazenerf train` or `gazenerf share`, and in a repository."""

HOW = "pip install gazenerf[hub]"

_ADDRESS = re.compile(r"hf:/{1,2}(?P<repository>[\w.-]+/[\w.-]+)(?:@(?P<revision>[\w./-]+))?")
"""One slash where the address was taken for a path."""


def field_file(place: str | Path, most_bytes: int, **how: Any) -> Path:
    """The file of weights at a place.

    Args:
        place: A file; a folder that holds `field.safetensors`; or `hf://OWNER/NAME`, with `@REVISION` where it is not
            the newest, which is downloaded into Hugging Face's cache unless it is there.
        most_bytes: A larger file is not downloaded.
        how: More arguments of `huggingface_hub.hf_hub_download`, such as `revision` or `token`.

    Raises:
        UserError: an address of another form, no such repository or file in it, or the extra `hub` is not installed.
    """
    text = str(place)
    if text.startswith("hf:"):
        found = _ADDRESS.fullmatch(text)
        if found is None:
            raise UserError(f"{text} is no address of a field; write hf://OWNER/NAME or hf://OWNER/NAME@REVISION")
        named = {} if found["revision"] is None else {"revision": found["revision"]}
        return _downloaded(found["repository"], most_bytes, how | named)
    path = Path(place)
    return path / WEIGHTS if path.is_dir() else path


def hub_library() -> Any:
    """The module `huggingface_hub`.

    Raises:
        UserError: it is not installed.
    """
    try:
        import huggingface_hub
    except ImportError as error:
        raise UserError(f"sharing fields through the Hugging Face Hub needs: {HOW}") from error
    return huggingface_hub


def _downloaded(repository: str, most_bytes: int, how: dict[str, Any]) -> Path:
    hub = hub_library()
    asked = {"repo_id": repository, "filename": WEIGHTS, "library_name": "gazenerf", **how}
    logging.getLogger("huggingface_hub").setLevel(logging.ERROR)  # what fails is said below, in one line
    try:
        size = hub.hf_hub_download(**asked, dry_run=True).file_size
        if size is None or size > most_bytes:
            known = "of unknown size" if size is None else f"of {size >> 20} MiB"
            raise UserError(f"{WEIGHTS} of {repository} is {known}; a field has {most_bytes >> 20} MiB at most")
        return Path(hub.hf_hub_download(**asked))
    except (OSError, ValueError, hub.errors.EntryNotFoundError) as error:
        reason = " ".join(str(error).split())[:200]
        address = repository if how.get("revision") is None else f"{repository}@{how['revision']}"
        raise UserError(
            f"no {WEIGHTS} from hf://{address} ({reason}); check the address and the connection, or download the "
            "repository and give its folder"
        ) from error
