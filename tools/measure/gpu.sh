#!/usr/bin/env bash
# Graphics card in one go: self-test, bandwidth and arithmetic ceilings, each kernel beside its floor, pictures and steps
# a second, memory. Writes forward.json, train.json and gpu.txt:
#   tools/measure/gpu.sh [FOLDER] [--device N] [--tiny]        (FOLDER: out/gpu; --tiny: for software devices)
set -euo pipefail
folder=out/gpu
if [[ $# -gt 0 && $1 != -* ]]; then
    folder=$1
    shift
fi
here=$(realpath "$(dirname "$0")")
python=${PYTHON:-python}
mkdir -p "$folder"
{
    date -u +%F
    "$python" "$here/gpu_forward.py" -o "$folder/forward.json" "$@"
    "$python" "$here/gpu_train.py" -o "$folder/train.json" "$@"
} | tee "$folder/gpu.txt"
