#!/usr/bin/env bash
# Fuzz the C part of the codec: scripts/fuzz/fuzz.sh [SECONDS per target, 60] [TARGET...].
# Builds codec_c/fuzz/*.c with clang's libFuzzer and the address and undefined-behaviour
# sanitizers, and runs the targets side by side, one per processor. Inputs that reached new code are
# kept in build/fuzz/corpus, findings in build/fuzz/findings. Exit code 1 if there is a finding.
# RUNS=n stops a target after n executions, JOBS=n runs n targets at a time, TIMEOUT=n is how long
# an input may take, by the clock on the wall: more than 60 s if other programs stop this one.
# CHECK=memory: the memory sanitizer instead, which sees what is read before it is written.
# PYTHON names the Python that has clgs (for the seeds).
# With --find: only print which clang that is; exit code 1 if there is none.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.."
python=${PYTHON:-.venv/bin/python}
checks=address,undefined
build=$PWD/build/fuzz
if [ "${CHECK:-}" = memory ]; then
    checks=memory,undefined
    build+=_memory
fi
flags=(-std=c11 -g -O2 "-fsanitize=$checks" -fno-sanitize-recover=all)
include=(-Icodec_c/include -Icodec_c/src)

# The first clang that links a target: clang may be there without its sanitizer runtime.
find_clang() {
    local name
    for name in clang clang-15 clang-14 clang-16 clang-17 clang-18 clang-19 clang-20 clang-21; do
        if command -v "$name" >/dev/null 2>&1 &&
            echo 'int LLVMFuzzerTestOneInput(const char *d, long n) { return d && n < 0; }' |
            "$name" "${flags[@]}" -fsanitize=fuzzer -x c - -o "$build/probe" 2>/dev/null; then
            printf '%s\n' "$name"
            return 0
        fi
    done
    return 1
}

mkdir -p "$build" "$build/findings"
if [ "${1:-}" = --find ]; then
    find_clang
    exit
fi
seconds=${1:-60}
[ $# -eq 0 ] || shift
if ! clang=$(find_clang); then
    if [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ]; then
        echo "fuzz: error: no clang with libFuzzer; CI installs it and must not go without" >&2
        exit 1
    fi
    echo "fuzz: skipped: no clang with libFuzzer; install clang and its runtime (libclang-rt-dev)"
    exit 0
fi
if [ $# -eq 0 ]; then
    for file in codec_c/fuzz/*.c; do
        set -- "$@" "$(basename "$file" .c)"
    done
fi

# The library once; targets link to it. Calls that tell the fuzzer what each comparison compared
# took three quarters of the time: an entropy coder compares at every bit, and formats have no magic
# words longer than a byte. Files that fill tables for every stream go without any checks under
# the address sanitizer: the C tests and the memory sanitizer check them.
plain=" entropy/mix octree/model attributes/choose "
[ "$checks" = address,undefined ] || plain=
compile() {
    local name=$1 object=$build/lib/${1/\//_}.o
    if [[ $plain = *" $name "* ]]; then
        "$clang" -std=c11 -O3 -march=native "${include[@]}" -c "codec_c/src/$name.c" -o "$object"
    else
        "$clang" "${flags[@]}" -fsanitize=fuzzer-no-link -fno-sanitize-coverage=trace-cmp \
            "${include[@]}" -c "codec_c/src/$name.c" -o "$object"
    fi
}
rm -rf "$build/lib"
mkdir -p "$build/lib"
for file in codec_c/src/*/*.c; do
    name=${file#codec_c/src/}
    compile "${name%.c}" # one at a time: seconds in all
done
for target in "$@"; do
    "$clang" "${flags[@]}" -fsanitize=fuzzer -fno-sanitize-coverage=trace-cmp "${include[@]}" \
        "codec_c/fuzz/$target.c" "$build"/lib/*.o -o "$build/$target"
done
"$python" scripts/fuzz/seeds.py "$build/seeds"

# One target: its report in $build/<target>.log, one line on stdout.
run_target() {
    local target=$1 log=$2/$1.log status=0
    mkdir -p "$2/corpus/$target" "$2/seeds/$target"
    "$2/$target" -max_total_time="$3" -runs="$4" -timeout="${TIMEOUT:-60}" -rss_limit_mb=1024 \
        -malloc_limit_mb=128 -max_len=512 -print_final_stats=1 \
        -artifact_prefix="$2/findings/$target-" \
        "$2/corpus/$target" "$2/seeds/$target" >"$log" 2>&1 || status=$?
    printf 'fuzz: %-21s %10s executions, %6s a second, %s\n' "$target" \
        "$(sed -n 's/^stat::number_of_executed_units: *//p' "$log")" \
        "$(sed -n 's/^stat::average_exec_per_sec: *//p' "$log")" \
        "$([ "$status" = 0 ] && echo 'no finding' || echo "FINDING, see $log")"
    return "$status"
}
export -f run_target
export ASAN_OPTIONS=quarantine_size_mb=4
printf '%s\n' "$@" | xargs -P "${JOBS:-$(nproc)}" -I{} bash -c 'run_target "$@"' - {} \
    "$build" "$seconds" "${RUNS:--1}"
