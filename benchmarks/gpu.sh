#!/usr/bin/env bash
# What a GPU does with the bundled field, as JSON, in under four minutes: see benchmarks/gpu.py.
#   benchmarks/gpu.sh OUT.json [--device cpu --quick]
# On a machine that has only torch, the few other packages are installed into a folder of their own: from WHEELS, a folder
# of wheels for a machine without a network, else from the package index. PYTHON chooses the interpreter.
set -euo pipefail
out=$(realpath -m "${1:?give a file for the results}")
shift
cd "$(dirname "$0")/.."
python=${PYTHON:-$([[ -x .venv/bin/python ]] && echo .venv/bin/python || echo python3)}
needed=(numpy scipy cv2 PIL safetensors skimage trimesh)
missing=$("$python" - "${needed[@]}" <<'PY'
import importlib.util
import sys

packages = {"cv2": "opencv-contrib-python-headless", "PIL": "pillow", "skimage": "scikit-image"}
print(*(packages.get(name, name) for name in sys.argv[1:] if importlib.util.find_spec(name) is None))
PY
)
if [[ -n $missing ]]; then
	folder=$(mktemp -d)
	trap 'rm -rf "$folder"' EXIT
	source=(--constraint constraints.txt)
	[[ -n ${WHEELS:-} ]] && source=(--no-index --find-links "$WHEELS")
	# shellcheck disable=SC2086
	"$python" -m pip install --quiet --target "$folder" "${source[@]}" $missing ||
		echo "benchmarks/gpu.sh: cannot install $missing; what needs them is left out" >&2
	export PYTHONPATH="$folder${PYTHONPATH:+:$PYTHONPATH}"
fi
"$python" -m benchmarks.gpu --out "$out" "$@"
