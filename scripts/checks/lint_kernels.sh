#!/usr/bin/env bash
# Compile every kernel file with clang, warnings as errors, in both specialisations. Catches what
# OpenCL drivers accept silently, such as a double constant on a device that has doubles.
# With --find: only print which clang that is; exit code 1 where there is none.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.."

find_clang() {
    local name
    for name in clang-15 clang clang-14 clang-16 clang-17 clang-18 clang-19 clang-20 clang-21; do
        if command -v "$name" >/dev/null 2>&1; then
            printf '%s\n' "$name"
            return 0
        fi
    done
    return 1
}

if [ "${1:-}" = --find ]; then
    find_clang
    exit
fi
if ! clang=$(find_clang); then
    if [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ]; then
        echo "lint_kernels: error: no clang; CI installs it and must not go without" >&2
        exit 1
    fi
    echo "lint_kernels: skipped: no clang; install clang to run this check"
    exit 0
fi

failed=0
count=0
for file in kernels_cl/*/*.cl; do
    for specialisation in "-DVEC=16 -DUSE_LOCAL=0" "-DVEC=1 -DUSE_LOCAL=1"; do
        read -r -a defines <<<"$specialisation"
        "$clang" -x cl -cl-std=CL1.2 -Xclang -finclude-default-header -fsyntax-only \
            -Wall -Wextra -Wdouble-promotion -Wconversion -Wno-sign-conversion -Werror \
            -target spir-unknown-unknown -Xclang -cl-ext=-cl_khr_fp64 \
            -I kernels_cl "${defines[@]}" "$file" || failed=1
        count=$((count + 1))
    done
done
[ "$failed" = 0 ] && echo "lint_kernels: $count builds with $clang, no warnings"
exit "$failed"
