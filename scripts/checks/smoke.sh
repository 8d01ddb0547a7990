#!/usr/bin/env bash
# Train 50 steps on a small capture that it makes itself, encode, decode, render and evaluate:
# scripts/checks/smoke.sh BIN FOLDER, BIN holding clgs and python, FOLDER (new) for what comes out.
set -euo pipefail

bin=$1
work=$2
here=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)

mkdir "$work"
"$bin/python" "$here/../make_capture.py" "$work/data"
"$bin/clgs" train "$work/data" -o "$work/run" --steps 50
"$bin/clgs" encode "$work/run" -o "$work/scene.clgs"
"$bin/clgs" info "$work/scene.clgs"
"$bin/clgs" decode "$work/scene.clgs" -o "$work/scene.npz"
"$bin/clgs" render "$work/scene.clgs" --data "$work/data" --split test -o "$work/views"
"$bin/clgs" eval "$work/scene.clgs" --data "$work/data" --json "$work/eval.json"
