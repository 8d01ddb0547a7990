#!/usr/bin/env bash
# What of codec_c/src the fuzz targets and the C tests reach:
# scripts/fuzz/coverage.sh [CORPUS, build/fuzz/corpus]. Runs every input that scripts/fuzz/fuzz.sh has
# kept (CORPUS/<target>/), its seeds and the tests once, and prints lines and branches reached, by
# file: the targets alone, then with the tests, which pass sizes out of range. Lines not reached: `llvm-cov show` as it is called below.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.."
corpus=${1:-$PWD/build/fuzz/corpus}
build=$PWD/build/fuzz_coverage
if ! clang=$(scripts/fuzz/fuzz.sh --find); then
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
flags=(-std=c11 -O1 -fprofile-instr-generate -fcoverage-mapping -Icodec_c/include -Icodec_c/src)
for file in codec_c/src/*/*.c; do
    name=${file#codec_c/src/}
    "$clang" "${flags[@]}" -c "$file" -o "$build/${name/\//_}.o"
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
report() {
    "$(tool llvm-profdata)" merge "$build"/*.profraw -o "$build/profile"
    "$(tool llvm-cov)" report "${programs[@]:1}" -instr-profile "$build/profile" codec_c/src
}
report | tail -n 1 | sed 's/^TOTAL /targets/'
for test in test_codec test_attributes test_known vectors; do
    "$clang" "${flags[@]}" "tests/c/$test.c" "$build"/*.o -o "$build/$test"
    LLVM_PROFILE_FILE=$build/$test.profraw "$build/$test" >"$build/$test.log" 2>&1
    programs+=(-object "$build/$test")
done
report
