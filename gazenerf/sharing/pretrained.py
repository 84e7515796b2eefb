"""A field saved and loaded by huggingface_hub's mixin; to import this module needs `pip install gazenerf[hub]`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from huggingface_hub import ModelCard, ModelCardData, ModelHubMixin

from gazenerf.checkpoints import MAX_BYTES, load_field, save_field, weights_hash
from gazenerf.field.model import TwoStreamField
from gazenerf.shared_files import WEIGHTS, field_file
from gazenerf.sharing.card import TEMPLATE, card_facts

TAGS = ["gaze-redirection", "gazenerf", "nerf", "talking-heads", "3d"]


class PretrainedField(
    ModelHubMixin,
    library_name="gazenerf",
    paper_url="https://arxiv.org/abs/2212.04823",
    model_card_template=TEMPLATE,
    tags=TAGS,
):
    """A field with `save_pretrained`, `from_pretrained` and `push_to_hub`, as huggingface_hub documents them.

    `save_pretrained(folder)` writes `field.safetensors`, its configuration as `config.json`, and a model card
    `README.md` unless one is there. `from_pretrained(place)` reads a folder, or a repository `OWNER/NAME` of the Hub;
    the weights are checked as those of every checkpoint.

    Args:
        field: What is shared.
        report: Of `gazenerf evaluate`, for the model card.
        half: Save float16.

    Attributes:
        saved_hash: Of the weights that were last saved; None before.

    Example:
        >>> PretrainedField(gazenerf.checkpoints.load_field("portrait-sdf")).save_pretrained("my-field")
        >>> PretrainedField.from_pretrained("my-field").field.config.image_size
        512
    """

    def __init__(self, field: TwoStreamField, report: dict[str, Any] | None = None, half: bool = False) -> None:
        self.field, self.report, self.half = field, report, half
        self.saved_hash: str | None = None

    def _save_pretrained(self, save_directory: Path) -> None:
        save_field(self.field, save_directory / WEIGHTS, half=self.half)
        self.saved_hash = weights_hash(save_directory / WEIGHTS)
        text = json.dumps(self.field.config.to_dict(), indent=2)
        (save_directory / "config.json").write_text(text + "\n", encoding="utf-8")

    @classmethod
    def _from_pretrained(
        cls,
        *,
        model_id: str,
        revision: str | None,
        cache_dir: str | Path | None,
        force_download: bool,
        local_files_only: bool,
        token: str | bool | None,
        **model_kwargs: Any,
    ) -> PretrainedField:
        if Path(model_id).is_dir():
            return cls(load_field(model_id))
        found = field_file(
            f"hf://{model_id}", MAX_BYTES, revision=revision, token=token, cache_dir=cache_dir,
            force_download=force_download, local_files_only=local_files_only,
        )  # fmt: skip
        return cls(load_field(found))

    def generate_model_card(self, *args: Any, **kwargs: Any) -> ModelCard:
        """The model card; `name` and `license` among the keyword arguments are the title and the weights' licence."""
        about = self._hub_mixin_info.model_card_data.to_dict()
        if kwargs.get("license"):
            about["license"] = kwargs["license"]
        name = kwargs.get("name") or "A gaze-redirecting head field"
        facts = card_facts(self.field, self.report) | {"weights_hash": self.saved_hash or self.field.weights_hash}
        return ModelCard.from_template(ModelCardData(**about), template_str=TEMPLATE, name=name, **facts)
