"""`gazenerf train-estimator`: learn to read gaze and head pose off pictures."""

from __future__ import annotations

from gazenerf.training.estimator_run import EstimatorOptions, train_estimator

HELP = "train an estimator of gaze and head pose on captures, for evaluate"

Options = EstimatorOptions


def run(options: EstimatorOptions) -> int:
    """Train and report."""
    from gazenerf.cli.common import showing_progress, summary_table
    from gazenerf.cli.report import current
    from gazenerf.devices import choose_device

    current().choose(network=options.network, device=choose_device(options.device))
    with showing_progress() as progress:
        made = train_estimator(options, progress)
    rows: dict[str, object] = {"weights": made.file, "report": made.report}
    for name, errors in made.about["held_out"].items():
        of = name.replace("_", " ")
        rows[f"gaze of {of}"] = f"{errors['mean_deg']:.2f} deg mean, {errors['median_deg']:.2f} median"
        rows[f"head of {of}"] = f"{errors['head']['mean_deg']:.2f} deg mean, {errors['head']['median_deg']:.2f} median"
    pictures = made.about["training"]["pictures"]
    title = f"{options.network} on {pictures} pictures of {made.about['people']} people"
    summary_table(title, rows, measured=made.about["held_out"])
    return 0
