#!/usr/bin/env bash
# Check every kernel file with clang, in each of its forms: vectors of 16 and of 8 lanes for CPUs,
# scalars and local memory for GPUs. Then the other code that build options choose.
#   - Warnings are errors. OpenCL drivers accept silently what these catch, such as a double
#     constant on a device that has doubles.
#   - No symbol stays undefined when the unoptimised program is linked with libclc for an AMD and an
#     NVIDIA GPU, or translated to SPIR-V. The GPU form is compiled to machine code of both, too.
# With --missing: only print the Debian packages that this check lacks here, none if all are there.
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

find_libclc() {
    local folder
    for folder in /usr/lib/clc /usr/share/clc /usr/local/share/clc; do
        if [ -f "$folder/nvptx64--nvidiacl.bc" ] && [ -f "$folder/amdgcn--amdhsa.bc" ]; then
            printf '%s\n' "$folder"
            return 0
        fi
    done
    return 1
}

clang=$(find_clang) || clang=
version=$([ -z "$clang" ] || "$clang" -dumpversion | cut -d. -f1)
libclc=$(find_libclc) || libclc=
spirv=$(command -v "llvm-spirv-$version" || command -v llvm-spirv) || spirv=

missing_packages() {
    if [ -z "$clang" ]; then
        echo clang
        return
    fi
    [ -n "$libclc" ] || echo "libclc-$version"
    [ -n "$spirv" ] || echo "llvm-spirv-$version"
}

if [ "${1:-}" = --missing ]; then
    missing_packages
    exit
fi

skip() { # reason
    if [ "${CI:-}" = true ] && [ "$(id -u)" = 0 ]; then
        echo "lint_kernels: error: $1; CI must not go without" >&2
        exit 1
    fi
    echo "lint_kernels: skipped: $1"
}

compile() { # target, options of clang with a file or - for standard input
    local target=$1
    shift
    local flags=(-x cl -cl-std=CL1.2 -I kernels_cl)
    case $target in
    spir) flags+=(-target spir64-unknown-unknown) ;;
    amdgcn) flags+=(-target amdgcn-amd-amdhsa -mcpu=gfx900 -nogpulib
        -Xclang -mlink-builtin-bitcode -Xclang "$libclc/amdgcn--amdhsa.bc" -Wno-linker-warnings) ;;
    nvptx64) flags+=(-target nvptx64--nvidiacl
        -Xclang -mlink-builtin-bitcode -Xclang "$libclc/nvptx64--nvidiacl.bc") ;;
    esac
    "$clang" "${flags[@]}" "$@"
}

warnings() { # file, defines
    compile spir -fsyntax-only -Xclang -cl-ext=-cl_khr_fp64 \
        -Wall -Wextra -Wdouble-promotion -Wconversion -Wno-sign-conversion -Werror "${@:2}" "$1"
}

undefined() { # target, file, defines: names of the functions that nobody defines
    if [ "$1" = spir ]; then
        compile spir -O0 -w -emit-llvm -c -o - "${@:3}" "$2" | "$spirv" -spirv-text -o - - |
            sed -n 's/.*LinkageAttributes "\(.*\)" Import.*/\1/p' | sed '/^__spirv_/d'
    else
        compile "$1" -O0 -w -emit-llvm -S -o - "${@:3}" "$2" |
            sed -n 's/^declare .*@\([A-Za-z0-9_.$]*\)(.*/\1/p' | sed '/^llvm\./d'
    fi
}

check() { # file, defines
    local target names failed=0
    warnings "$@" || failed=1
    for target in $targets; do
        if ! names=$(undefined "$target" "$@"); then
            echo "$1 (${*:2}): does not compile for $target" >&2
            failed=1
        elif [ -n "$names" ]; then
            echo "$1 (${*:2}): undefined for $target: ${names//$'\n'/, }" >&2
            failed=1
        elif [ "$target" != spir ] && [[ "$*" == *USE_LOCAL=1* ]]; then
            compile "$target" -O1 -w -S -o /dev/null "${@:2}" "$1" || failed=1
        fi
    done
    return "$failed"
}

forms() { # file, defines: one line per form
    [[ $1 == *_gpu.cl ]] || printf '%s -DVEC=%s -DUSE_LOCAL=0\n' "$*" 16 "$*" 8
    [[ $1 == *_cpu.cl ]] || printf '%s -DVEC=1 -DUSE_LOCAL=1\n' "$*"
}

jobs() { # one line per file, form and choice of code
    local file
    for file in kernels_cl/*/*.cl; do
        forms "$file"
    done
    forms kernels_cl/views/views.cl -DFISHEYE=1 -DCOMPENSATED=1
    forms kernels_cl/views/views.cl -DPARALLEL_RAYS=1 -DBY_COVARIANCE=1 -DCOMPENSATED=1
    forms kernels_cl/views/harmonics.cl -DCOEFFICIENTS=25 -DBARE_SUMS=1
    for file in kernels_cl/channels/*.cl; do
        forms "$file" -DWITH_DEPTH=1 -DWITH_ABSOLUTE=1
    done
    forms kernels_cl/match/nearest_cpu.cl -DTILES_AT_ONCE=1 -DROWS=4
}

if [ -z "$clang" ]; then
    skip "no clang; install clang to run this check"
    exit 0
fi
targets=
if [ -z "$libclc" ]; then
    skip "amdgcn and nvptx64: no libclc; install libclc-$version"
elif ! echo '__kernel void k(__global float *x) { *x = fma(*x, *x, *x); }' |
    compile nvptx64 -w -emit-llvm -S -o /dev/null - 2>/dev/null; then
    skip "amdgcn and nvptx64: $libclc is not of the version of $clang; install libclc-$version"
else
    targets="amdgcn nvptx64"
fi
if [ -z "$spirv" ]; then
    skip "SPIR-V: no llvm-spirv; install llvm-spirv-$version"
else
    targets="$targets spir"
fi

# What passed once is not checked again until a kernel, a tool or this file changes.
everything() {
    find kernels_cl -type f -exec cksum {} + | LC_ALL=C sort
    cat scripts/checks/lint_kernels.sh
    "$clang" --version
    echo "$targets"
}
state=$(everything | cksum)
stamp=build/kernel_lint.stamp
if [ "$state" = "$(cat "$stamp" 2>/dev/null)" ]; then
    echo "lint_kernels: nothing has changed since all builds passed"
    exit 0
fi

export clang libclc spirv targets
export -f compile warnings undefined check
if ! jobs | xargs -P "$(nproc)" -L 1 bash -c 'set -o pipefail; check "$@"' check; then
    echo "lint_kernels: failed" >&2
    exit 1
fi
mkdir -p build
echo "$state" >"$stamp"
echo "lint_kernels: $(jobs | wc -l) builds with $clang for ${targets:-no GPU}, no complaints"
