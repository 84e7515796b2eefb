"""Is a field one consistent 3D head? Measure it against renders of its head model: report.html, report.json.

python examples/04_check.py [OUT] [VIEWS] [SIZE]
"""

import sys
from pathlib import Path

import gazenerf
from gazenerf.head_model import ReferenceHead
from gazenerf.viz import CheckOptions, check_subject, write_report


def main(out: Path, views: int, size: int) -> None:
    """Write the report and print what needs attention."""
    head = gazenerf.load()
    reference = ReferenceHead.of(head.subject)  # the fitted 3DMM; anything with .at(gaze) -> HeadMesh will do
    options = CheckOptions(views=views, size=size, gazes=1)
    result = check_subject(head, reference, options)

    for metric in result.metrics:
        if metric.verdict in ("warn", "fail"):
            print(f"{metric.verdict}: {metric.label} {metric.value:.3g} {metric.unit}")
            print(f"  {metric.definition.meaning} {metric.definition.advice}")
    print(f"depth error: {result.metric('depth_median_mm').value:.2f} mm (median)")
    page, numbers = write_report(result, out)
    print(page, numbers)


if __name__ == "__main__":
    out, views, size = (*sys.argv[1:], *("out/examples", "4", "256")[len(sys.argv) - 1 :])
    main(Path(out), int(views), int(size))
