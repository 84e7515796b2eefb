"""`gazenerf share`: a field with its model card, as the Hugging Face Hub takes it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gazenerf.options import option

HELP = "write a field with a model card, to publish it"


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the command takes.

    Attributes:
        checkpoint: A bundled field's name or a file of weights.
        out: Folder to write.
        report: What was measured of the field.
        name: Title of the model card.
        license: Of the weights.
        half: Store float16.
        overwrite: Replace what is there.
    """

    checkpoint: Path = option(help="field to share: a bundled name, a file, or a run's folder", metavar="FIELD")
    out: Path = option(help="folder to write", metavar="DIR")
    report: Path | None = option(None, "JSON of `gazenerf evaluate`, for the model card", metavar="FILE")
    name: str | None = option(None, "title of the model card (default: the folder's name)", metavar="TEXT")
    license: str | None = option(None, "licence of the weights, such as cc-by-4.0", metavar="ID")
    half: bool = option(False, "store the weights in half precision")
    overwrite: bool = option(False, "replace what is there")


def run(options: Options) -> int:
    """Write the folder."""
    from gazenerf.checkpoints import load_field
    from gazenerf.cli.common import summary_table
    from gazenerf.files import refuse_existing, whole_folder
    from gazenerf.shared_files import WEIGHTS, hub_library
    from gazenerf.sharing.card import read_report

    hub_library()
    from gazenerf.sharing.pretrained import PretrainedField

    refuse_existing([options.out], options.overwrite)
    field = load_field(options.checkpoint)
    report = None if options.report is None else read_report(options.report, str(field.weights_hash))
    with whole_folder(options.out) as temporary:
        shared = PretrainedField(field, report, half=options.half)
        about = {"name": options.name or options.out.resolve().name, "license": options.license}
        shared.save_pretrained(temporary, model_card_kwargs=about)
    written = [options.out / name for name in (WEIGHTS, "config.json", "README.md")]
    size = written[0].stat().st_size
    rows = {"model card": written[2], "weights": f"{written[0]}, {size / 2**20:.1f} MiB"}
    summary_table("shared field", rows, {"bytes": size, "weights_hash": shared.saved_hash}, written)
    print(f"publish it with: hf upload OWNER/NAME {options.out}")
    return 0
