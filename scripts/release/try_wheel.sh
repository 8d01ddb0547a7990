#!/usr/bin/env bash
# Try a wheel as a user has it: scripts/release/try_wheel.sh WHEEL [PYTHON]. An empty environment,
# no compiler on PATH, OpenCL from the pocl extra alone: clgs devices, the self-test, and a small
# scene trained, encoded, decoded, rendered and scored. PoCL's wheel is for Linux on x86-64 only.
set -euo pipefail

die() {
    printf 'try_wheel: error: %s\n' "$*" >&2
    exit 1
}

here=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")" && pwd)
wheel=$(realpath -- "${1:?usage: try_wheel.sh WHEEL [PYTHON]}")
base=${2:-python3}
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$base" -m venv "$work/venv" </dev/null || die "cannot make a virtual environment"
bin=$work/venv/bin
"$bin/python" -m pip install --quiet --disable-pip-version-check --only-binary :all: \
    "$wheel[pocl]" </dev/null || die "pip could not install $wheel"

# What the scripts call, and no compiler. PoCL's wheel calls a linker.
mkdir "$work/bin" "$work/home"
for tool in bash dirname env ld mkdir; do
    ln -s "$(command -v "$tool")" "$work/bin/$tool"
done
vendors=$(dirname -- "$(find "$work/venv" -name 'pocl*.icd' | head -n 1)")
clean() {
    env -i HOME="$work/home" PATH="$work/bin:$bin" TMPDIR="$work" OCL_ICD_VENDORS="$vendors" "$@"
}
cd "$work"
! clean bash -c "command -v cc gcc clang" || die "a compiler is on PATH"
clean clgs --version
clean clgs devices
clean clgs selftest --device 0 # the folder above is looked into twice
clean "$here/../checks/smoke.sh" "$bin" "$work/smoke"
echo "try_wheel: $(basename -- "$wheel") works"
