#!/usr/bin/env bash
# What only a release needs, hours in all: scripts/release_checks.sh [WORD]. Sets up first. Runs the
# checks whose name holds WORD, all by default, and goes on after one that fails; exit code 1 then.
# FUZZ_SECONDS=n: per fuzz target, 36000 by default; DAMAGE=n: damaged files, a million by default.
set -euo pipefail

# shellcheck source=scripts/setup.sh
. "$(dirname -- "${BASH_SOURCE[0]}")/setup.sh"
cd "$root"
only=${1:-}
failed=()

# check NAME COMMAND...
check() {
    local name=$1
    shift
    [[ $name = *"$only"* ]] || return 0
    printf '\n== %s (%d s)\n' "$name" "$SECONDS"
    "$@" || failed+=("$name")
}

# The same bits on a second implementation, in both forms of the kernels.
intel_runtime() {
    local folder=$root/build/intel_runtime form status=0
    scripts/checks/intel_runtime.sh "$folder" >/dev/null || return 1
    for form in cpu gpu; do
        CLGS_SPECIALISATION=$form "$venv/bin/clgs" conformance -o "$folder/$form.json" --overwrite &&
            OCL_ICD_VENDORS=$folder/vendors CLGS_SPECIALISATION=$form "$venv/bin/clgs" conformance \
                --device "Intel(R) OpenCL" --check "$folder/$form.json" || status=1
    done
    return "$status"
}

# And on Mesa's rusticl: 20 minutes, since its device is slow.
rusticl() {
    local folder=$root/build/rusticl
    scripts/checks/rusticl.sh "$folder" >/dev/null || return 1
    OCL_ICD_VENDORS=$folder/vendors RUSTICL_ENABLE=llvmpipe \
        LD_LIBRARY_PATH=$folder/usr/lib/x86_64-linux-gnu "$venv/bin/clgs" accept --quick \
        --device rusticl --overwrite -o "$folder/accept.json"
}

try_wheel() {
    scripts/release/wheels.sh x86_64 && scripts/release/try_wheel.sh dist/clgs-*x86_64.whl "$python"
}

check "release tests" "$python" -m pytest -q -m release --durations=20 # one at a time: memory
check "other examples" "$python" -m pytest -q -m hypothesis --hypothesis-profile=new
check "seeded bugs" "$python" scripts/checks/mutation_check.py
check "race check" scripts/checks/race_check.sh "$python"
check "bytes across compilers" scripts/checks/cross_check.sh
check "compilers of vendors" env PYTHON="$python" scripts/checks/vendor_compilers.sh
check "damage" "$python" -m tests.codec.container.mutations "${DAMAGE:-1000000}"
check "intel runtime" intel_runtime
check "rusticl" rusticl
check "wheel for another processor" scripts/release/wheels.sh aarch64
check "wheel without compiler" try_wheel
check "fuzz" env PYTHON="$python" RUNS=1000000 scripts/fuzz/fuzz.sh "${FUZZ_SECONDS:-36000}"
check "fuzz, memory" env PYTHON="$python" RUNS=1000000 CHECK=memory \
    scripts/fuzz/fuzz.sh "${FUZZ_SECONDS:-36000}"

if [ ${#failed[@]} -gt 0 ]; then
    printf 'release_checks: FAILED: %s\n' "${failed[@]}" >&2
    exit 1
fi
echo "release_checks: all passed"
