#!/usr/bin/env bash
# Lint and test: ./scripts/test.sh [--ci] [PYTEST ARGUMENTS]. Sets up first.
# --ci adds the C tests under sanitizers, seconds per fuzz target, a race check of one training step
# and a short training run. Its tests, slow ones included, run once: on a wheel that is installed
# outside of the checkout. scripts/release_checks.sh has what takes hours.
set -euo pipefail

unset PYTHONDONTWRITEBYTECODE # else each of the many processes compiles tests and clgs again

ci=
if [ "${1:-}" = --ci ]; then
    ci=1
    shift
    export CI=true # a check whose tool is missing fails if the tool can be installed
fi

# shellcheck source=scripts/setup.sh
. "$(dirname -- "${BASH_SOURCE[0]}")/setup.sh"
cd "$root"
bin=$venv/bin

step() {
    printf '\n== %s (%d s)\n' "$1" "$SECONDS"
}

# alongside FUNCTION: runs it next to what follows. What it says is shown when `join` waits for it.
alongside() {
    set -m # a process group of its own, so that all of it ends with this script
    "$1" >"$work/alongside" 2>&1 &
    set +m
    other=$!
}

# Fails if the function that runs alongside does.
join() {
    local status=0
    wait "$other" || status=$?
    cat "$work/alongside"
    return "$status"
}

# Runs even if the checkout belongs to another user, as in a container.
source_files() {
    find "$@" -type f \( -name '*.cl' -o -name '*.c' -o -name '*.h' -o -name '*.cpp' \) -print0
}

install_kernel_lint() {
    local missing
    for _ in 1 2; do # clang first, then what fits its version
        mapfile -t missing < <(scripts/checks/lint_kernels.sh --missing)
        [ "${#missing[@]}" = 0 ] || apt_install "${missing[@]}" || true # the check says what it lacks
    done
}

lint() {
    step "lint"
    "$bin/ruff" format --check .
    "$bin/ruff" check .
    "$bin/mypy"
    source_files kernels_cl codec_c web/wasm tests/c scripts/gpu_counts | xargs -0 "$bin/clang-format" --dry-run --Werror
    if [ -n "$ci" ] && on_debian_as_root; then
        install_kernel_lint
    fi
    scripts/checks/lint_kernels.sh
}

checkout_tests() {
    step "tests of the checkout"
    "$python" -m pytest -q --durations=5 -m "not release" tests/house
}

docs() {
    step "documentation and its links"
    scripts/docs.sh --check
}

test_c() {
    step "C tests under sanitizers"
    command -v "$bin/cmake" >/dev/null || "$python" -m pip install --quiet 'cmake>=3.25' </dev/null
    "$bin/cmake" -S . -B build/c -DCLGS_SANITIZE=ON -DCLGS_WERROR=ON >/dev/null
    "$bin/cmake" --build build/c --parallel "$(nproc)"
    "$bin/ctest" --test-dir build/c --output-on-failure --parallel "$(nproc)"
}

fuzz() {
    step "fuzz targets of the codec"
    if on_debian_as_root && ! scripts/fuzz/fuzz.sh --find >/dev/null; then
        apt_install clang libclang-rt-dev || true # fuzz.sh says what is missing
    fi
    PYTHON=$python scripts/fuzz/fuzz.sh 5
    step "fuzz targets under the memory sanitizer"
    PYTHON=$python CHECK=memory scripts/fuzz/fuzz.sh 3
}

race_check() {
    step "race check"
    scripts/checks/race_check.sh --step "$python"
}

checks_of_the_checkout() {
    lint # next to the wheel's tests, since it uses one core
    checkout_tests
    docs
    test_c
    fuzz
    race_check
}

# The wheel, with all that its metadata ask for, in $work/venv: it finds them among the packages of
# $venv, where they are already; clgs of the checkout is hidden. The tests are in $work/tree.
build_wheel() {
    step "wheel"
    "$python" -m pip wheel --quiet --no-deps --wheel-dir "$work/dist" . </dev/null
    wheel=$(echo "$work"/dist/clgs-*.whl)
    "$python" scripts/checks/check_wheel.py "$wheel"
    "$python" -m venv --without-pip "$work/venv" </dev/null
    local folder='import sysconfig; print(sysconfig.get_path("purelib"))'
    "$python" -c "$folder" >"$("$work/venv/bin/python" -c "$folder")/packages.pth"
    "$python" -m pip --python "$work/venv" install --quiet --no-index "$wheel[dev]" </dev/null
    mkdir "$work/tree"
    cp -R pyproject.toml codec_c scripts tests "$work/tree"
}

smoke() {
    step "selftest" # of the other form: among the tests, by `clgs accept`
    CLGS_SPECIALISATION=gpu "$work/venv/bin/clgs" selftest
    step "the same bits twice, in each form of the kernels"
    for form in cpu gpu; do
        CLGS_SPECIALISATION=$form "$work/venv/bin/clgs" conformance -o "$work/$form.json"
        POCL_MAX_PTHREAD_COUNT=1 CLGS_SPECIALISATION=$form \
            "$work/venv/bin/clgs" conformance --check "$work/$form.json"
    done
    step "a training run of 50 steps, and its file"
    "$root/scripts/checks/smoke.sh" "$work/venv/bin" "$work/smoke"
}

# A file's tests stay in one process: they share devices, data and scenes. Files begin in order: those
# of the commands, which take longest, are not left for the end.
spread=(-n auto --maxprocesses 8 --dist loadfile --no-loadscope-reorder)

if [ -z "$ci" ]; then
    lint
    step "tests"
    exec "$python" -m pytest "${spread[@]}" "$@"
fi

work=$(mktemp -d)
other=
trap '[ -z "$other" ] || kill -- "-$other" 2>/dev/null || true; rm -rf "$work"' EXIT
alongside checks_of_the_checkout
build_wheel
cd "$work/tree"
export CLGS_TEST_KERNELS=$work/kernels # where one process at a time builds now, and tests look then
POCL_CACHE_DIR=$CLGS_TEST_KERNELS smoke
step "tests of the wheel, slow ones included"
export CLGS_SHARED_DATA=${CLGS_SHARED_DATA:-$root/../shared/data}
status=0
"$work/venv/bin/python" -m pytest "${spread[@]}" -q --durations=20 -m "not release" --ignore tests/house "$@" || status=$?
join || status=$?
step "done"
exit "$status"
