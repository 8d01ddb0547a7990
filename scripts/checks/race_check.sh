#!/usr/bin/env bash
# Run training steps and the self-test of tiny scenes under Oclgrind, which finds data races and
# accesses out of bounds in the kernels: scripts/checks/race_check.sh [--step] [PYTHON], a Python
# that has clgs. --step: one training step in each form of the kernels, and no more.
set -euo pipefail

step=
if [ "${1:-}" = --step ]; then
    step=--step
    shift
fi

# shellcheck source=scripts/setup.sh
. "$(dirname -- "${BASH_SOURCE[0]}")/../setup.sh"
python=${1:-$python}

find_oclgrind() {
    find /usr/lib /usr/local/lib -name 'liboclgrind-rt-icd.so' 2>/dev/null | head -n 1
}

library=$(find_oclgrind)
if [ -z "$library" ] && on_debian_as_root; then
    apt_install oclgrind || true
    library=$(find_oclgrind)
fi
if [ -z "$library" ]; then
    if [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ]; then
        echo "race_check: error: no Oclgrind; CI installs it and must not go without" >&2
        exit 1
    fi
    echo "race_check: skipped: no Oclgrind; install it (Debian, Ubuntu: oclgrind)"
    exit 0
fi

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
mkdir "$work/vendors"
printf '%s\n' "$library" >"$work/vendors/oclgrind.icd"
# Oclgrind 21.10 does not know some intrinsics that the optimiser makes. Every new context empties
# its log: hence one process and one log for each form of the kernels.
watched() {
    env -u PYOPENCL_CTX OCLGRIND_BUILD_OPTIONS=-cl-opt-disable OCL_ICD_VENDORS="$work/vendors" \
        OCLGRIND_DATA_RACES=1 OCLGRIND_LOG="$work/log.$1" PYOPENCL_NO_CACHE=1 "${@:2}"
}
for form in cpu gpu; do
    watched "$form" "$python" "$root/scripts/checks/race_scene.py" oclgrind "$form" $step
    [ -z "$step" ] || continue
    # the errors of a third implementation, and the stages that a step has only in part
    CLGS_SPECIALISATION=$form watched "selftest.$form" \
        "$python" -m clgs selftest --device oclgrind >"$work/selftest.$form" ||
        { cat "$work/selftest.$form"; exit 1; }
    head -n 1 "$work/selftest.$form"
done
cat "$work"/log.* >"$work/log"
if [ -s "$work/log" ]; then
    head -n 40 "$work/log" >&2
    echo "race_check: Oclgrind complains; see the lines above" >&2
    exit 1
fi
echo "race_check: no races, no accesses out of bounds"
