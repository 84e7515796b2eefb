"""`gazenerf train`: learn a field from captures."""

from __future__ import annotations

from gazenerf.training.run import TrainOptions, train_field

HELP = "train a field on captures"

Options = TrainOptions


def run(options: TrainOptions) -> int:
    """Train and report."""
    import os

    from gazenerf.cli.common import showing_progress, warn
    from gazenerf.cli.report import current
    from gazenerf.devices import choose_device
    from gazenerf.training.models import STED

    current().choose(
        model=options.model, preset=options.preset, device=choose_device(options.device), precision=options.precision
    )
    with showing_progress(show=os.environ.get("LOCAL_RANK", "0") == "0") as progress:
        if options.model == STED:
            from gazenerf.baselines.sted.run import train_sted_on

            written = train_sted_on(options, progress)
        else:
            written = train_field(options, progress, warn)
    if written is not None:
        current().add([written])
        print(f"wrote {written}")
    return 0
