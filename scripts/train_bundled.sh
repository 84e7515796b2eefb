#!/usr/bin/env bash
# Rebuild the bundled field and subjects: captures, training (resumable), half-precision weights, quality.
#   scripts/train_bundled.sh FOLDER [extra arguments of `gazenerf train`]
# Run it again with --resume after a kill. The malloc settings keep freed memory in the process, which
# halves the time of a step on a CPU.
set -euo pipefail
folder=${1:?give a folder for captures and the run}
shift
export MALLOC_MMAP_THRESHOLD_=8589934592 MALLOC_TRIM_THRESHOLD_=17179869184 MALLOC_TOP_PAD_=1073741824
gazenerf synthesize --out "$folder/captures" --people 14 --views 90 --size 256 --seed 1
gazenerf train --data "$folder/captures" --out "$folder/run" --held-out 2 "$@"
python scripts/make_subjects.py --data "$folder/captures" --trained 0 1 2 3 4 5 --held-out 12 13
python - "$folder/run/field.safetensors" <<'PY'
import sys

from gazenerf.checkpoints import BUNDLED, load_field, save_field

save_field(load_field(sys.argv[1]), BUNDLED, half=True)
PY
gazenerf evaluate --data "$folder/captures" --held-out 2 --out "$folder/quality.json"
