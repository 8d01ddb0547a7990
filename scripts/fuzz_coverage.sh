#!/usr/bin/env bash
# What of codec_c/src the fuzz targets reach: scripts/fuzz_coverage.sh [CORPUS, build/fuzz/corpus].
# Runs every input that scripts/fuzz.sh has kept (CORPUS/<target>/) and its seeds once, and prints
# lines and branches reached, by file. Lines not reached: `llvm-cov show` as it is called below.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."
corpus=${1:-$PWD/build/fuzz/corpus}
build=$PWD/build/fuzz_coverage
if ! clang=$(scripts/fuzz.sh --find); then
    echo "fuzz_coverage: skipped: no clang with libFuzzer"
    exit 0
fi

# llvm's tools of the same version, with or without it in their names.
tool() {
    local version=${clang#clang}
    command -v "$1$version" || command -v "$1"
}

rm -rf "$build"
mkdir -p "$build"
flags=(-std=c11 -O1 -fprofile-instr-generate -fcoverage-mapping -Icodec_c/include)
for file in codec_c/src/*.c; do
    "$clang" "${flags[@]}" -fsanitize=fuzzer-no-link -c "$file" -o "$build/$(basename "$file" .c).o"
done
programs=()
for file in codec_c/fuzz/*.c; do
    target=$(basename "$file" .c)
    "$clang" "${flags[@]}" -fsanitize=fuzzer "$file" "$build"/*.o -o "$build/$target"
    mkdir -p "$corpus/$target"
    LLVM_PROFILE_FILE=$build/$target.profraw "$build/$target" -runs=0 -timeout=600 \
        "$corpus/$target" "build/fuzz/seeds/$target" >"$build/$target.log" 2>&1
    programs+=(-object "$build/$target")
done
"$(tool llvm-profdata)" merge "$build"/*.profraw -o "$build/profile"
"$(tool llvm-cov)" report "${programs[@]:1}" -instr-profile "$build/profile" codec_c/src
