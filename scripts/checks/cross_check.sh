#!/usr/bin/env bash
# The same bytes everywhere: scripts/checks/cross_check.sh. Builds the test vectors of the codec
# (tests/c/vectors.c) with gcc and clang, without and with optimisation, for 64 and 32 bits, and for
# big-endian processors under qemu-user, and compares all hashes with tests/c/vectors.txt.
# What is not installed is skipped with a reason; exit code 1 if bytes differ.
# With --write: write vectors.txt again, after a change of an encoder.
set -euo pipefail

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/../.."
build=build/cross
flags=(-std=c11 -Wall -Wextra -Wconversion -Werror -Icodec_c/include -Icodec_c/src)
sources=(tests/c/vectors.c codec_c/src/*/*.c)
failed=0
mkdir -p "$build"

# check NAME RUNNER COMPILER FLAGS...: one build, and its hashes
check() {
    local name=$1 runner=$2 program
    shift 2
    program=$build/${name//[ ,]/_}
    if ! command -v "$1" >/dev/null 2>&1; then
        echo "cross_check: $name: skipped: no $1"
    elif [ -n "$runner" ] && ! command -v "$runner" >/dev/null 2>&1; then
        echo "cross_check: $name: skipped: no $runner"
    elif ! echo 'int main(void) { return 0; }' |
        "$@" -x c - -o "$build/probe" 2>/dev/null; then
        echo "cross_check: $name: skipped: $1 cannot link for it"
    elif ! "$@" "${flags[@]}" "${sources[@]}" -o "$program"; then
        echo "cross_check: $name: does not compile"
        failed=1
    elif ${runner:+"$runner"} "$program" tests/c/vectors.txt; then
        echo "cross_check: $name: the same bytes"
    else
        echo "cross_check: $name: bytes DIFFER"
        failed=1
    fi
}

if [ "${1:-}" = --write ]; then
    "${CC:-cc}" -O2 "${flags[@]}" "${sources[@]}" -o "$build/write"
    "$build/write" >tests/c/vectors.txt
    echo "cross_check: $(wc -l <tests/c/vectors.txt) vectors written"
    exit 0
fi
clang=$(command -v clang clang-15 clang-14 clang-19 | head -n 1 || true)
for optimisation in -O0 -O3; do
    check "gcc $optimisation" '' gcc "$optimisation"
    check "clang $optimisation" '' "${clang:-clang}" "$optimisation"
    check "gcc $optimisation, 32 bits" '' gcc -m32 "$optimisation"
done
check "clang -O2, 32 bits" '' "${clang:-clang}" -m32 -O2
check "gcc -O3, every instruction of this processor" '' gcc -O3 -march=native
check "gcc, PowerPC, 32 bits, big-endian" qemu-ppc-static powerpc-linux-gnu-gcc -static -O2
check "gcc, s390x, 64 bits, big-endian" qemu-s390x-static s390x-linux-gnu-gcc -static -O2
exit "$failed"
